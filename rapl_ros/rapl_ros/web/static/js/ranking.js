// The order that a person is making: which place each video has. Knows nothing of the page.

export class Ranking {
  constructor(count) {
    this.count = count;
    this.places = new Array(count).fill(null); // 1 = best; null: none yet
    this.last = null; // place given last, which a tie shares
    this.tieNext = false;
    this.filled = null; // the video that got its place because it was the only one left
    this.before = []; // what was, step by step
  }

  get complete() {
    return this.places.every((place) => place !== null);
  }

  get empty() {
    return this.places.every((place) => place === null);
  }

  note() {
    const { places, last, tieNext, filled } = this;
    this.before.push({ places: [...places], last, tieNext, filled });
  }

  // Take the last step back; false: there was none.
  back() {
    if (!this.before.length) return false;
    Object.assign(this, this.before.pop());
    return true;
  }

  // Give a video a place; null takes its place away.
  set(video, place) {
    this.note();
    this.put(video, place);
  }

  put(video, place) {
    this.places[video] = place;
    this.last = place;
    this.tieNext = false;
    this.filled = null;
  }

  // Give a video the best place that is free, or, after a tie, the place given last. A second pick
  // takes the place away. When one video is left, it gets what remains.
  pick(video) {
    this.note();
    if (video === this.filled) {
      this.filled = null;
      return;
    }
    if (this.places[video] !== null) {
      this.put(video, null);
      return;
    }
    this.put(video, this.tieNext ? this.last : this.nextFree());
    const left = this.places.flatMap((place, index) => (place === null ? [index] : []));
    if (left.length === 1) {
      this.places[left[0]] = this.nextFree();
      this.filled = left[0];
    }
  }

  // The video picked next, or the one that was left over, shares the place given last.
  tie() {
    this.note();
    if (this.filled !== null) {
      this.places[this.filled] = this.last;
      this.filled = null;
    } else if (!this.complete && this.last !== null) {
      this.tieNext = !this.tieNext;
    }
  }

  setAll(places) {
    this.note();
    this.places = [...places];
    this.last = null;
    this.tieNext = false;
    this.filled = null;
  }

  // The best place that no video has and no tie takes up: two that are best leave no second.
  nextFree() {
    for (let place = 1; place <= this.count; place += 1) {
      const better = this.places.filter((other) => other !== null && other < place).length;
      if (!this.places.includes(place) && better === place - 1) return place;
    }
    return this.count;
  }

  // As the server takes them: 1 = best, equal numbers tie, 1 + the number of better videos.
  ranks() {
    return this.places.map((place) => 1 + this.places.filter((other) => other < place).length);
  }

  // "2 best, then 1 and 3 equal."
  words() {
    const groups = new Map();
    this.places.forEach((place, video) => {
      if (place !== null) groups.set(place, [...(groups.get(place) ?? []), video + 1]);
    });
    const texts = [...groups.keys()].sort((a, b) => a - b).map((place) => {
      const videos = groups.get(place);
      return videos.length > 1 ? `${videos.join(" and ")} equal` : `${videos[0]}`;
    });
    if (groups.size === 1 && this.complete) return "All are equally good.";
    return texts.length ? `${texts.join(", then ")}.` : "";
  }
}

// What the places are called.
export function placeNames(count) {
  if (count === 2) return ["Better", "Worse"];
  if (count === 3) return ["Best", "Middle", "Worst"];
  return Array.from({ length: count }, (_, index) => {
    if (index === 0) return "Best";
    return index === count - 1 ? "Worst" : `${index + 1}`;
  });
}
