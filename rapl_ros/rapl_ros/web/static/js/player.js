// Plays several videos exactly in step: one clock, each frame cut from its video's sheet.

import { getBlob } from "./api.js";

const HOLD_S = 0.7; // on the last frame, so that one sees how it ended

export async function loadSheet(video) {
  const bitmap = await createImageBitmap(await getBlob(video.url));
  return { ...video, bitmap };
}

export class Player {
  constructor(onTick) {
    this.onTick = onTick;
    this.videos = [];
    this.time = 0;
    this.speed = 1;
    this.playing = true;
    this.before = null;
    this.tick = this.tick.bind(this);
    requestAnimationFrame(this.tick);
  }

  // Of the longest video, in seconds of its own time.
  get duration() {
    return Math.max(0.001, ...this.videos.map(({ sheet }) => sheet.frames * sheet.period_s));
  }

  get step() {
    return Math.min(...this.videos.map(({ sheet }) => sheet.period_s));
  }

  show(canvases, sheets) {
    for (const { sheet } of this.videos) {
      if (!sheets.includes(sheet)) sheet.bitmap.close();
    }
    this.videos = sheets.map((sheet, index) => {
      const canvas = canvases[index];
      canvas.width = sheet.width;
      canvas.height = sheet.height;
      return { sheet, context: canvas.getContext("2d", { alpha: false }), frame: -1 };
    });
    this.time = 0;
    this.playing = true;
    this.before = null;
    this.draw();
  }

  // Lets go of the videos without closing them: they will be shown again.
  release() {
    this.videos = [];
  }

  seek(time) {
    this.time = Math.min(Math.max(0, time), this.duration - 1e-6);
    this.draw();
  }

  tick(now) {
    requestAnimationFrame(this.tick);
    const passed = this.before === null ? 0 : Math.min(0.25, (now - this.before) / 1000);
    this.before = now;
    if (!this.videos.length || !this.playing) return;
    this.time += passed * this.speed;
    if (this.time > this.duration + HOLD_S * this.speed) this.time = 0;
    this.draw();
  }

  draw() {
    for (const video of this.videos) {
      const { sheet, context } = video;
      const frame = Math.min(sheet.frames - 1, Math.floor(this.time / sheet.period_s + 1e-6));
      if (frame === video.frame) continue;
      video.frame = frame;
      const x = (frame % sheet.columns) * sheet.width;
      const y = Math.floor(frame / sheet.columns) * sheet.height;
      context.drawImage(sheet.bitmap, x, y, sheet.width, sheet.height, 0, 0, sheet.width, sheet.height);
    }
    this.onTick(Math.min(1, this.time / this.duration));
  }
}
