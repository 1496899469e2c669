// The page on which people rank.

import { ApiError, get, newId, post } from "./api.js";
import { Dragging } from "./drag.js";
import { icon } from "./icons.js";
import { setUpKeys } from "./keys.js";
import { loadSheet, Player } from "./player.js";
import { placeNames, Ranking } from "./ranking.js";
import { settings } from "./settings.js";
import { setUpTheme } from "./theme.js";

const RETRY_MS = 2000;
const SPEEDS = [0.5, 1, 2, 4];
const byId = (id) => document.getElementById(id);

let current = null; // {query, sheets}: what is shown
let ranking = null; // the order being made
let answerIds = {}; // by verdict, of the answer being made: the same when it is sent again
let ahead = []; // what comes next, fetched already
let fetching = null; // a promise of one more
let busy = false;
let shownAt = 0;

const player = new Player((share) => {
  byId("scrub").value = Math.round(share * 1000);
});
const dragging = new Dragging(byId("tray"), (video, place) => place_(video, place));

// Fetching

async function fetchQuery() {
  const held = [current, ...ahead].filter(Boolean).map(({ query }) => query.query_id);
  const query = await post("/api/queries", { annotator: settings.name, held });
  const sheets = await Promise.all(query.videos.map(loadSheet));
  return { query, sheets };
}

function fetchAhead() {
  if (fetching || ahead.length) return;
  const name = settings.name;
  fetching = fetchQuery()
    .then((entry) => name === settings.name && ahead.push(entry)) // else for who was here before
    .catch(() => {}) // told when it is wanted
    .finally(() => (fetching = null));
}

// Show the next query, as soon as there is one; began: when the person asked for it.
async function advance(began) {
  player.release();
  for (const { bitmap } of current?.sheets ?? []) bitmap.close();
  current = null;
  if (!ahead.length && fetching) await fetching;
  while (!current) {
    try {
      show(ahead.shift() ?? (await fetchQuery()), began);
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      if (error.code === "token_needed") return unlock();
      showEmpty(error);
      await new Promise((resolve) => setTimeout(resolve, RETRY_MS));
    }
  }
}

function showEmpty(error) {
  byId("main").dataset.state = "empty";
  byId("empty").hidden = false;
  const waits = error.code === "no_query";
  byId("empty-title").textContent = waits ? "Nothing to rank just now" : "The page cannot go on";
  byId("empty-text").textContent = `${error.message} This page goes on by itself.`;
  refreshStanding();
}

// Showing

function show(entry, began = performance.now(), places = null) {
  const asked = performance.now();
  current = entry;
  answerIds = {};
  ranking = new Ranking(entry.query.videos.length);
  if (places) ranking.setAll(places);
  byId("empty").hidden = true;
  byId("main").dataset.state = "ready";
  buildCards(entry.query.videos);
  const canvases = [...document.querySelectorAll(".card canvas")];
  player.speed = SPEEDS.includes(settings.speed) ? settings.speed : 1;
  player.show(canvases, entry.sheets);
  update();
  shownAt = performance.now();
  requestAnimationFrame(() => {
    // The first frames are painted now.
    performance.measure("query-to-playing", { start: asked });
    performance.measure("submit-to-next", { start: began });
    document.body.dataset.query = entry.query.query_id;
    fetchAhead();
  });
}

function buildCards(videos) {
  const names = placeNames(videos.length);
  const cards = byId("cards");
  cards.style.setProperty("--count", videos.length);
  cards.style.setProperty("--columns", videos.length <= 4 ? videos.length : Math.ceil(videos.length / 2));
  dragging.setPlaces(names);
  const focused = document.activeElement?.closest?.(".card, .actions");
  cards.replaceChildren(...videos.map((video, index) => buildCard(video, index, names)));
  // Begin anew at the videos: Enter must not press the button of the last answer again.
  if (focused) cards.focus({ preventScroll: true });
}

function buildCard(video, index, names) {
  const card = document.createElement("article");
  card.className = "card";
  const button = document.createElement("button");
  button.type = "button";
  button.className = "video";
  button.style.setProperty("--aspect", video.width / video.height);
  const canvas = document.createElement("canvas");
  const number = document.createElement("span");
  number.className = "number";
  number.textContent = index + 1;
  button.append(canvas, number);
  dragging.attach(button, index);
  button.addEventListener("click", () => pick(index));
  card.append(button, buildPlaces(index, names));
  return card;
}

function buildPlaces(index, names) {
  const places = document.createElement("fieldset");
  places.className = "places";
  const legend = document.createElement("legend");
  legend.className = "unseen";
  legend.textContent = `Place of video ${index + 1}`;
  places.append(legend);
  names.forEach((name, place) => {
    const label = document.createElement("label");
    const input = document.createElement("input");
    input.type = "radio";
    input.name = `place-${index}`;
    input.value = place + 1;
    input.addEventListener("change", () => place_(index, place + 1));
    const text = document.createElement("span");
    text.textContent = name;
    label.append(input, text);
    places.append(label);
  });
  return places;
}

// The order that is being made

function pick(video) {
  if (!ranking || video >= ranking.count) return;
  ranking.pick(video);
  update(true);
}

function place_(video, place) {
  ranking.set(video, place);
  update(true);
}

function tie() {
  ranking?.tie();
  update(true);
}

function update(changed = false) {
  const names = placeNames(ranking.count);
  const level = (place) => {
    if (place === null) return "none";
    if (place === 1) return "best";
    return place === ranking.count ? "worst" : "middle";
  };
  document.querySelectorAll(".card").forEach((card, index) => {
    const place = ranking.places[index];
    card.dataset.level = level(place);
    for (const input of card.querySelectorAll(".places input")) {
      input.checked = Number(input.value) === place;
    }
    const said = place === null ? "no place yet" : names[place - 1].toLowerCase();
    card.querySelector(".video").ariaLabel = `Video ${index + 1}: ${said}`;
  });
  byId("save").disabled = !ranking.complete;
  const words = ranking.words();
  const hint = ranking.empty
    ? "Choose the videos from best to worst."
    : `From the best: ${words}${ranking.tieNext ? " The next one ties with the last." : ""}`;
  byId("hint").textContent = hint;
  if (changed) answerIds = {};
  if (changed) say(ranking.complete ? `${hint} Save with Enter.` : hint);
}

// Answers

async function answer(verdict) {
  if (busy || !current || (verdict === "ranked" && !ranking.complete)) return;
  busy = true;
  const began = performance.now();
  const body = {
    ranking_id: (answerIds[verdict] ??= newId()),
    query_id: current.query.query_id,
    annotator: settings.name,
    verdict,
    ranks: verdict === "ranked" ? ranking.ranks() : [],
    response_s: Math.min(86400, (began - shownAt) / 1000),
  };
  try {
    const { standing } = await post("/api/rankings", body);
    showStanding(standing);
    hideToast();
    byId("undo").disabled = false;
    say("Saved. Next videos.");
    await advance(began);
    refreshStanding();
  } catch (error) {
    if (!(error instanceof ApiError)) throw error;
    if (error.status === 409) await replace(error);
    else toast(`Not saved. ${error.message}`);
  } finally {
    busy = false;
  }
}

// The query cannot be answered any more: it was answered elsewhere or came back too late. Ask for
// it again; the order made so far stays where it is given again.
async function replace(error) {
  const { query, sheets } = current;
  const places = ranking.places;
  current = null;
  ahead = [];
  try {
    const entry = await fetchQuery();
    if (entry.query.query_id === query.query_id) {
      toast("The time for these videos had run out; they are yours again. Please save once more.");
      show(entry, performance.now(), places);
    } else {
      toast(`Not saved: ${error.message}`);
      show(entry);
    }
  } catch {
    current = { query, sheets };
    toast(`Not saved. ${error.message}`);
  }
}

async function undo() {
  if (busy) return;
  busy = true;
  try {
    const undone = await post("/api/undo", { annotator: settings.name, withdrawal_id: newId() });
    const sheets = await Promise.all(undone.query.videos.map(loadSheet));
    if (current) {
      player.release(); // it comes again
      ahead.unshift(current);
    }
    show({ query: undone.query, sheets }, performance.now(), undone.verdict === "ranked" ? undone.ranks : null);
    showStanding(undone.standing);
    say(`Your last answer is taken back. ${byId("hint").textContent}`);
  } catch (error) {
    if (!(error instanceof ApiError)) throw error;
    toast(error.status === 409 ? "There is nothing to take back." : error.message);
  } finally {
    busy = false;
  }
}

// Standing

function showStanding({ given, wanted, needed }) {
  byId("standing").hidden = false;
  byId("standing-count").textContent = needed ? `${given} of ${wanted}` : `${given} ranked`;
  byId("standing-more").textContent = needed ? `· ${needed} still needed` : wanted ? "· enough; more make it better" : "";
  byId("standing-bar").hidden = !wanted;
  if (wanted) byId("standing-bar").value = Math.min(1, given / wanted);
}

async function refreshStanding() {
  try {
    const progress = await get("/api/progress");
    showStanding(progress.standing);
    const own = progress.annotators.find(({ annotator }) => annotator === settings.name);
    byId("undo").disabled = !own || own.ranked + own.undecided + own.skipped === 0;
    byId("consistency").textContent =
      own?.consistency == null
        ? ""
        : `Own consistency ${Math.round(own.consistency * 100)} % (${own.consistency_pairs} pairs)`;
  } catch {
    // the next answer tells
  }
}

// Saying

function say(text) {
  byId("said").textContent = text;
}

let toastTimer = 0;

function toast(text) {
  clearTimeout(toastTimer);
  byId("toast").textContent = text;
  byId("toast").hidden = false;
  toastTimer = setTimeout(hideToast, 6000);
}

function hideToast() {
  byId("toast").hidden = true;
}

// Playing

function setPlaying(playing) {
  player.playing = playing;
  byId("play").replaceChildren(icon(playing ? "pause" : "play"));
  byId("play").ariaLabel = playing ? "Pause" : "Play";
  byId("play").title = `${playing ? "Pause" : "Play"} (space)`;
}

function replay() {
  player.seek(0);
  setPlaying(true);
}

function stepFrames(count) {
  setPlaying(false);
  player.seek((Math.round(player.time / player.step) + count) * player.step);
}

function setSpeed(speed) {
  player.speed = speed;
  settings.speed = speed;
  for (const input of document.querySelectorAll("[name=speed]")) {
    input.checked = Number(input.value) === speed;
  }
}

function changeSpeed(by) {
  const index = SPEEDS.indexOf(player.speed) + by;
  if (SPEEDS[index]) {
    setSpeed(SPEEDS[index]);
    say(`Speed ${SPEEDS[index]}`);
  }
}

function setUpPlaying() {
  byId("replay").append(icon("replay"));
  byId("play").addEventListener("click", () => setPlaying(!player.playing));
  byId("replay").addEventListener("click", replay);
  byId("scrub").addEventListener("input", (event) => {
    setPlaying(false);
    player.seek((event.target.value / 1000) * player.duration);
  });
  for (const input of document.querySelectorAll("[name=speed]")) {
    input.addEventListener("change", () => setSpeed(Number(input.value)));
  }
  setSpeed(SPEEDS.includes(settings.speed) ? settings.speed : 1);
  setPlaying(true);
}

// Who and how

function askName() {
  const dialog = byId("who");
  byId("name").value = settings.name ?? "";
  byId("name-error").textContent = "";
  dialog.showModal();
}

function setUpName() {
  byId("who-form").addEventListener("submit", async (event) => {
    event.preventDefault();
    const name = byId("name").value.trim().replace(/\s+/g, " ").normalize("NFC");
    try {
      const query = await post("/api/queries", { annotator: name, held: [] });
      begin(name, query);
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      if (error.status === 422) {
        byId("name-error").textContent = error.message.replace(/^annotator: (Value error, )?/, "");
      } else if (error.code === "token_needed") {
        byId("who").close();
        unlock();
      } else {
        begin(name, null);
      }
    }
  });
  byId("who").addEventListener("cancel", (event) => settings.name || event.preventDefault());
  byId("person").addEventListener("click", askName);
}

async function begin(name, query) {
  settings.name = name;
  byId("who").close();
  showName();
  ahead = query ? [{ query, sheets: await Promise.all(query.videos.map(loadSheet)) }] : [];
  if (!settings.helped) {
    settings.helped = true;
    byId("help").showModal();
  }
  advance(performance.now());
  refreshStanding();
}

function showName() {
  byId("person").textContent = settings.name;
  byId("person").ariaLabel = `Ranking as ${settings.name}. Change the name.`;
  byId("person").hidden = false;
}

function unlock() {
  byId("locked").showModal();
}

function setUpDialogs() {
  byId("locked").addEventListener("cancel", (event) => event.preventDefault());
  byId("locked-form").addEventListener("submit", () => {
    settings.token = byId("token").value.trim().replace(/^.*#token=/, "");
    location.reload();
  });
  byId("help-open").addEventListener("click", () => byId("help").showModal());
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

function start() {
  setUpTheme();
  setUpPlaying();
  setUpName();
  setUpDialogs();
  setUpKeys({
    pick,
    tie,
    replay,
    undo,
    stepFrames,
    changeSpeed,
    save: () => answer("ranked"),
    undecided: () => answer("undecided"),
    skip: () => answer("skipped"),
    equal: allEqual,
    togglePlaying: () => setPlaying(!player.playing),
    help: () => byId("help").showModal(),
  });
  byId("save").addEventListener("click", () => answer("ranked"));
  byId("undecided").addEventListener("click", () => answer("undecided"));
  byId("skip").addEventListener("click", () => answer("skipped"));
  byId("equal").addEventListener("click", allEqual);
  byId("undo").addEventListener("click", undo);
  if (!settings.name) {
    askName();
    return;
  }
  showName();
  advance(performance.now());
  refreshStanding();
}

// Like every order, it is seen before it is saved.
function allEqual() {
  if (!ranking) return;
  ranking.setAll(ranking.places.map(() => 1));
  update(true);
}

start();
