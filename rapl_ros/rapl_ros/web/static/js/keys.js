// Single keys as commands; they can be turned off, for those who speak or whose tools type.

import { settings } from "./settings.js";

// actions: what each command does.
export function setUpKeys(actions) {
  const commands = {
    t: actions.tie,
    "=": actions.tie,
    e: actions.equal,
    c: actions.undecided,
    s: actions.skip,
    u: actions.undo,
    z: actions.undo,
    Backspace: actions.back,
    r: actions.replay,
    " ": actions.togglePlaying,
    Enter: actions.save,
    ArrowLeft: () => actions.stepFrames(-1),
    ArrowRight: () => actions.stepFrames(1),
    "-": () => actions.changeSpeed(-1),
    ",": () => actions.changeSpeed(-1),
    "+": () => actions.changeSpeed(1),
    ".": () => actions.changeSpeed(1),
    "?": actions.help,
  };
  addEventListener("keydown", (event) => {
    if (document.querySelector("dialog[open]") || event.altKey || event.defaultPrevented) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (event.ctrlKey || event.metaKey) {
      if (key === "z" && !event.shiftKey) run(event, actions.undo);
      return;
    }
    if (isForTheControl(event.target, key)) return;
    if (settings.shortcuts === false && key.length === 1 && key !== " ") return;
    if (/^[1-9]$/.test(key)) run(event, () => actions.pick(Number(key) - 1));
    else if (Object.hasOwn(commands, key) && !(event.repeat && !key.startsWith("Arrow"))) {
      run(event, commands[key]);
    }
  });
}

function run(event, command) {
  event.preventDefault();
  command();
}

// Whether a control with the focus takes the key itself.
function isForTheControl(target, key) {
  if (target.matches("input[type=radio], input[type=range]")) {
    return key.startsWith("Arrow") || (key === " " && target.type === "radio");
  }
  if (target.matches("input, select, textarea")) return true;
  return target.matches("button, a") && (key === "Enter" || key === " ");
}
