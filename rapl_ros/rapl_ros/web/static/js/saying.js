// What the page says: aloud to screen readers, and for some seconds at the foot of the page.

const byId = (id) => document.getElementById(id);
const TOAST_MS = 6000;

export function say(text) {
  byId("said").textContent = text;
}

let timer = 0;

export function toast(text) {
  clearTimeout(timer);
  byId("toast").textContent = text;
  byId("toast").hidden = false;
  timer = setTimeout(hideToast, TOAST_MS);
}

export function hideToast() {
  byId("toast").hidden = true;
}
