// Dialogs: who ranks, the token, how it works.

import { ApiError } from "./api.js";
import { settings } from "./settings.js";
import { progressOf } from "./standing.js";

const byId = (id) => document.getElementById(id);

export function askName() {
  byId("name").value = settings.name ?? "";
  showStep(null);
  if (!byId("who").open) byId("who").showModal();
}

export function unlock() {
  if (!byId("locked").open) byId("locked").showModal();
}

export function showName() {
  byId("person").textContent = settings.name;
  byId("person").ariaLabel = `Ranking as ${settings.name}. Change the name.`;
  byId("person").hidden = false;
}

export function openHelp() {
  byId("help").showModal();
}

// known: under which name somebody has ranked already, if that is to be asked.
function showStep(known) {
  byId("name-error").textContent = "";
  byId("known").hidden = known === null;
  byId("who-ok").hidden = known !== null;
  if (known === null) return;
  byId("known-text").textContent = `${known} has ranked already. Is that you?`;
  byId("known-yes").focus();
}

// Whether another page of this name may be somebody else's is for the person to say.
async function check(name, begin) {
  try {
    const { annotators } = await progressOf(name);
    const known = annotators[0]?.annotator;
    if (!known || known === settings.name) return begin(known ?? name);
    showStep(known);
    byId("known-yes").onclick = () => begin(known);
  } catch (error) {
    if (!(error instanceof ApiError)) throw error;
    if (error.status === 422) {
      byId("name-error").textContent = error.message.replace(/^annotator: (Value error, )?/, "");
    } else if (error.code === "token_needed") {
      unlock();
    } else {
      byId("name-error").textContent = `${error.message} Please try again.`;
    }
  }
}

// begin(name): the person has said who it is.
export function setUpDialogs(begin) {
  byId("who-form").addEventListener("submit", (event) => {
    event.preventDefault();
    if (!byId("known").hidden) return;
    const name = byId("name").value.trim().replace(/\s+/g, " ").normalize("NFC");
    check(name, (chosen) => {
      settings.name = chosen;
      byId("who").close();
      begin();
    });
  });
  byId("name").addEventListener("input", () => showStep(null));
  byId("known-no").addEventListener("click", () => {
    byId("name").value = "";
    showStep(null);
    byId("name").focus();
  });
  byId("person").addEventListener("click", askName);
  // Browsers let a second Escape close any dialog; these two are not to be done without.
  byId("who").addEventListener("close", () => settings.name || askName());
  byId("locked").addEventListener("close", () => byId("token").value || unlock());
  byId("locked-form").addEventListener("submit", () => {
    settings.token = byId("token").value.trim().replace(/^.*#token=/, "");
    location.reload();
  });
  byId("help-open").addEventListener("click", openHelp);
  byId("shortcuts").checked = settings.shortcuts !== false;
  byId("shortcuts").addEventListener("change", (event) => {
    settings.shortcuts = event.target.checked;
    showKeys();
  });
  showKeys();
}

function showKeys() {
  document.querySelector(".keys").classList.toggle("off", settings.shortcuts === false);
}
