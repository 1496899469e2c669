// Plays several videos exactly in step: one clock, each frame cut from its video's sheet.

import { ApiError, getBlob } from "./api.js";

const HOLD_S = 0.7; // on the last frame, so that one sees how it ended

// The sheets of videos, decoded: their first frames can be drawn at once.
export async function loadSheets(videos) {
  const loaded = await Promise.allSettled(videos.map(loadSheet));
  const failed = loaded.find(({ status }) => status === "rejected");
  if (!failed) return loaded.map(({ value }) => value);
  closeSheets(loaded.flatMap(({ value }) => value ?? []));
  throw failed.reason;
}

export function closeSheets(sheets) {
  for (const { bitmap } of sheets) bitmap.close();
}

async function loadSheet(video) {
  for (const options of [{}, { cache: "reload" }]) {
    const blob = await getBlob(video.url, options);
    try {
      return { ...video, bitmap: await createImageBitmap(blob) };
    } catch {
      // a broken picture, which the browser may have kept: once more, past what it has kept
    }
  }
  throw new ApiError(0, "bad_picture", "A video came broken.");
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

  // From the start, playing or not as before.
  show(canvases, sheets) {
    this.videos = sheets.map((sheet, index) => {
      const canvas = canvases[index];
      canvas.width = sheet.width;
      canvas.height = sheet.height;
      return { sheet, context: canvas.getContext("2d", { alpha: false }), frame: -1 };
    });
    this.time = 0;
    this.before = null;
    this.draw();
  }

  // Lets go of the videos.
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
