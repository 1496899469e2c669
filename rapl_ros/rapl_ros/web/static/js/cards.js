// The videos of a query with the places under each. The cards stay and are used again.

import { placeNames } from "./ranking.js";

export class Cards {
  // onPick(video), onPlace(video, place): 1 = best.
  constructor(element, dragging, onPick, onPlace) {
    this.element = element;
    this.dragging = dragging;
    this.onPick = onPick;
    this.onPlace = onPlace;
    this.cards = [];
  }

  // Make room for the videos and return their canvases.
  show(videos) {
    const focused = document.activeElement?.closest?.(".card, .actions");
    if (this.cards.length !== videos.length) this.build(videos.length);
    this.cards.forEach(({ button }, index) => {
      button.style.setProperty("--aspect", videos[index].width / videos[index].height);
    });
    // Begin anew at the videos: Enter must not press the button of the last answer again.
    if (focused) this.element.focus({ preventScroll: true });
    return this.cards.map(({ canvas }) => canvas);
  }

  update(ranking) {
    const names = placeNames(ranking.count);
    const level = (place) => {
      if (place === null) return "none";
      if (place === 1) return "best";
      return place === ranking.count ? "worst" : "middle";
    };
    this.cards.forEach(({ card, button, inputs }, index) => {
      const place = ranking.places[index];
      card.dataset.level = level(place);
      inputs.forEach((input, number) => (input.checked = number + 1 === place));
      const said = place === null ? "no place yet" : names[place - 1].toLowerCase();
      button.ariaLabel = `Video ${index + 1}: ${said}`;
    });
  }

  build(count) {
    const names = placeNames(count);
    this.element.style.setProperty("--count", count);
    this.element.style.setProperty("--columns", count <= 4 ? count : Math.ceil(count / 2));
    this.dragging.setPlaces(names);
    this.cards = Array.from({ length: count }, (_, index) => this.buildCard(index, names));
    this.element.replaceChildren(...this.cards.map(({ card }) => card));
  }

  buildCard(index, names) {
    const card = document.createElement("article");
    card.className = "card";
    const button = document.createElement("button");
    button.type = "button";
    button.className = "video";
    const canvas = document.createElement("canvas");
    const number = document.createElement("span");
    number.className = "number";
    number.textContent = index + 1;
    button.append(canvas, number);
    this.dragging.attach(button, index);
    button.addEventListener("click", () => this.onPick(index));
    const { places, inputs } = this.buildPlaces(index, names);
    card.append(button, places);
    return { card, button, canvas, inputs };
  }

  buildPlaces(index, names) {
    const places = document.createElement("fieldset");
    places.className = "places";
    const legend = document.createElement("legend");
    legend.className = "unseen";
    legend.textContent = `Place of video ${index + 1}`;
    places.append(legend);
    const inputs = names.map((name, place) => {
      const label = document.createElement("label");
      const input = document.createElement("input");
      input.type = "radio";
      input.name = `place-${index}`;
      input.value = place + 1;
      input.addEventListener("change", () => this.onPlace(index, place + 1));
      const text = document.createElement("span");
      text.textContent = name;
      label.append(input, text);
      places.append(label);
      return input;
    });
    return { places, inputs };
  }
}
