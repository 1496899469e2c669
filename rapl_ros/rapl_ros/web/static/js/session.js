// What this tab remembers until it is closed, reloads included: who it is, and what was answered on it.

import { newId } from "./api.js";

const KEY = "rapl-page";
const MOST = 200;

function read() {
  try {
    return JSON.parse(sessionStorage.getItem(KEY)) ?? {};
  } catch {
    return {};
  }
}

const { page = newId(), name = "", answers = [] } = read();
const values = { page, name, answers };
keep();

function keep() {
  try {
    sessionStorage.setItem(KEY, JSON.stringify(values));
  } catch {
    // it holds until the page is reloaded
  }
}

export const session = {
  // Tells this page from others on which the same name ranks.
  get page() {
    return values.page;
  },

  // The id of the newest answer, which an undo takes back; empty: unknown.
  lastAnswer(annotator) {
    return values.name === annotator ? (values.answers.at(-1) ?? "") : "";
  },

  addAnswer(annotator, id) {
    if (values.name !== annotator) values.answers = [];
    values.name = annotator;
    values.answers = [...values.answers.filter((other) => other !== id), id].slice(-MOST);
    keep();
  },

  dropAnswer(id) {
    values.answers = values.answers.filter((other) => other !== id);
    keep();
  },
};
