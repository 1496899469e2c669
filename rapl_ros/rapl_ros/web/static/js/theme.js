// Light, dark, or as the system has it.

import { icon } from "./icons.js";
import { settings } from "./settings.js";

const NAMES = { auto: "as the system", light: "light", dark: "dark" };
const ORDER = ["auto", "light", "dark"];

function apply(button) {
  const theme = ORDER.includes(settings.theme) ? settings.theme : "auto";
  if (theme === "auto") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = theme;
  button.replaceChildren(icon(theme));
  button.ariaLabel = `Colours: ${NAMES[theme]}. Change.`;
  button.title = `Colours: ${NAMES[theme]}`;
}

export function setUpTheme() {
  const button = document.getElementById("theme");
  button.addEventListener("click", () => {
    settings.theme = ORDER[(ORDER.indexOf(settings.theme ?? "auto") + 1) % ORDER.length];
    apply(button);
  });
  apply(button);
}
