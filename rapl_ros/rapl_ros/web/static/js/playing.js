// The row of controls under the videos: play, scrub, speed.

import { icon } from "./icons.js";
import { Player } from "./player.js";
import { say } from "./saying.js";
import { settings } from "./settings.js";

const SPEEDS = [0.5, 1, 2, 4];
const byId = (id) => document.getElementById(id);

export class Playing {
  constructor() {
    this.player = new Player((share) => (byId("scrub").value = Math.round(share * 1000)));
    // What the person wants of the next videos too; scrubbing pauses only the present ones.
    this.wanted = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    byId("replay").append(icon("replay"));
    byId("play").addEventListener("click", () => this.toggle());
    byId("replay").addEventListener("click", () => this.replay());
    byId("scrub").addEventListener("input", (event) => {
      this.set(false);
      this.player.seek((event.target.value / 1000) * this.player.duration);
    });
    for (const input of document.querySelectorAll("[name=speed]")) {
      input.addEventListener("change", () => this.setSpeed(Number(input.value)));
    }
    this.setSpeed(SPEEDS.includes(settings.speed) ? settings.speed : 1);
    this.set(this.wanted);
  }

  show(canvases, sheets) {
    this.set(this.wanted);
    this.player.show(canvases, sheets);
  }

  set(playing) {
    this.player.playing = playing;
    byId("play").replaceChildren(icon(playing ? "pause" : "play"));
    byId("play").ariaLabel = playing ? "Pause" : "Play";
    byId("play").title = `${playing ? "Pause" : "Play"} (space)`;
  }

  toggle() {
    this.wanted = !this.player.playing;
    this.set(this.wanted);
  }

  replay() {
    this.player.seek(0);
    this.set(true);
  }

  step(count) {
    const { player } = this;
    if (!player.videos.length) return;
    this.set(false);
    player.seek((Math.round(player.time / player.step) + count) * player.step);
  }

  setSpeed(speed) {
    this.player.speed = speed;
    settings.speed = speed;
    for (const input of document.querySelectorAll("[name=speed]")) {
      input.checked = Number(input.value) === speed;
    }
  }

  changeSpeed(by) {
    const speed = SPEEDS[SPEEDS.indexOf(this.player.speed) + by];
    if (!speed) return;
    this.setSpeed(speed);
    say(`Speed ${speed}`);
  }
}
