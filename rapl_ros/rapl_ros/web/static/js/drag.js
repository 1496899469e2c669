// Dragging a video to a place: with mouse, pen or finger. The places appear while one drags.

const FAR = 8; // pixels: less is a click
const LONG_PRESS_MS = 250; // of a finger: what moves sooner scrolls the page, unless it goes sideways

export class Dragging {
  // onDrop(video, place): 1 = best; isBlocked(): whether nothing may be dragged now.
  constructor(tray, onDrop, isBlocked) {
    this.tray = tray;
    this.onDrop = onDrop;
    this.isBlocked = isBlocked;
    this.held = null;
    addEventListener("pointermove", (event) => this.move(event));
    addEventListener("pointerup", (event) => this.end(event));
    addEventListener("pointercancel", () => this.stop());
    addEventListener("keydown", (event) => event.key === "Escape" && this.stop());
    addEventListener("blur", () => this.stop());
  }

  setPlaces(names) {
    this.tray.replaceChildren(
      ...names.map((name, index) => {
        const place = document.createElement("div");
        place.textContent = name;
        place.dataset.place = index + 1;
        return place;
      }),
    );
  }

  // Make a video's button a handle.
  attach(button, video) {
    button.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || !event.isPrimary || this.isBlocked()) return;
      const held = { button, video, x: event.clientX, y: event.clientY, ghost: null };
      held.isTouch = event.pointerType === "touch";
      if (held.isTouch) held.timer = setTimeout(() => this.held === held && this.begin(held), LONG_PRESS_MS);
      this.held = held;
    });
    // While a video is dragged the page does not scroll, and a long press opens no menu.
    button.addEventListener("touchmove", (event) => this.held?.ghost && event.preventDefault(), { passive: false });
    button.addEventListener("contextmenu", (event) => this.held?.isTouch && event.preventDefault());
    button.addEventListener("dragstart", (event) => event.preventDefault());
    button.addEventListener(
      "click",
      (event) => {
        if (!this.justDropped) return;
        event.stopImmediatePropagation();
        event.preventDefault();
      },
      true,
    );
  }

  move(event) {
    const held = this.held;
    if (!held || !event.isPrimary) return;
    if (!held.ghost) {
      const [x, y] = [event.clientX - held.x, event.clientY - held.y];
      if (Math.hypot(x, y) < FAR) return;
      if (held.isTouch && Math.abs(y) > Math.abs(x)) return this.stop(); // it scrolls
      this.begin(held);
    }
    this.lead(held, event.clientX, event.clientY);
    const under = this.placeAt(event);
    for (const place of this.tray.children) place.classList.toggle("over", place === under);
  }

  lead({ ghost }, x, y) {
    ghost.style.transform = `translate(${x - ghost.offsetWidth / 2}px, ${y - ghost.offsetHeight / 2}px)`;
  }

  begin(held) {
    clearTimeout(held.timer);
    const shown = held.button.querySelector("canvas");
    held.ghost = document.createElement("canvas");
    held.ghost.className = "ghost";
    held.ghost.width = shown.width;
    held.ghost.height = shown.height;
    held.ghost.getContext("2d").drawImage(shown, 0, 0);
    document.body.append(held.ghost);
    document.body.classList.add("dragging");
    held.button.closest(".card").classList.add("dragged");
    this.tray.hidden = false;
    this.lead(held, held.x, held.y);
  }

  end(event) {
    const held = this.held;
    if (held?.ghost) {
      const place = this.placeAt(event);
      this.justDropped = true;
      setTimeout(() => (this.justDropped = false), 0); // after the click that follows
      if (place) this.onDrop(held.video, Number(place.dataset.place));
    }
    this.stop();
  }

  stop() {
    const held = this.held;
    this.held = null;
    clearTimeout(held?.timer);
    if (!held?.ghost) return;
    held.ghost.remove();
    held.button.closest(".card")?.classList.remove("dragged");
    document.body.classList.remove("dragging");
    this.tray.hidden = true;
    for (const place of this.tray.children) place.classList.remove("over");
  }

  placeAt(event) {
    return document.elementFromPoint(event.clientX, event.clientY)?.closest(".tray > div") ?? null;
  }
}
