// The page on which people rank.

import { ApiError, newId, post } from "./api.js";
import { Cards } from "./cards.js";
import { Dragging } from "./drag.js";
import { setUpKeys } from "./keys.js";
import { closeSheets, loadSheets } from "./player.js";
import { Playing } from "./playing.js";
import { Ranking } from "./ranking.js";
import { hideToast, say, toast } from "./saying.js";
import { session } from "./session.js";
import { settings } from "./settings.js";
import { standing } from "./standing.js";
import { setUpTheme } from "./theme.js";
import { askName, openHelp, setUpDialogs, showName, unlock } from "./who.js";

const RETRY_MS = 2000;
const SAVING_SHOWN_MS = 120; // sooner it would only flicker
const LOADING_SHOWN_MS = 250;
const PASSED_OVER = 4; // queries whose videos cannot be read
const REFRESH_EVERY = 10; // answers
const ENOUGH_LOOK_MS = 5000; // whether there is more to rank again
const AT_WORK_MS = 10000; // somebody may still be looking at videos shown so lately
const byId = (id) => document.getElementById(id);
const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

let current = null; // {query, sheets, received: when it came, unless fetched ahead}: what is shown
let ranking = null; // the order being made
let ahead = []; // what comes next, fetched already
let fetching = null; // a promise of one more
let round = 0; // of showing something: who began in an earlier one gives way
let busy = false; // something is being saved or taken back
let shownAt = 0;
let answered = 0;
let isOld = false; // what is shown was given out before more was wanted
let unsure = null; // an answer that was sent and whose fate is unknown
let undoing = null; // {id, target} of an undo whose fate is unknown

const playing = new Playing();
const dragging = new Dragging(byId("tray"), place_, () => busy || !current);
const cards = new Cards(byId("cards"), dragging, pick, place_);

// Fetching

async function fetchQuery() {
  const passed = [];
  while (true) {
    const mine = [current, ...ahead].filter(Boolean).map(({ query }) => query.query_id);
    const body = { annotator: settings.name, page: session.page, held: [...mine, ...passed] };
    const query = await post("/api/queries", body);
    const received = performance.now();
    try {
      return { query, sheets: await loadSheets(query.videos), received };
    } catch (error) {
      if (error.code !== "video_missing" || passed.length === PASSED_OVER) throw error;
      passed.push(query.query_id);
    }
  }
}

function fetchAhead() {
  if (fetching || ahead.length || standing.enough) return;
  const name = settings.name;
  fetching = fetchQuery()
    .then(({ query, sheets }) => (name === settings.name ? ahead.push({ query, sheets }) : closeSheets(sheets)))
    .catch(() => {}) // told when it is wanted
    .finally(() => (fetching = null));
}

function dropAhead() {
  for (const { sheets } of ahead) closeSheets(sheets);
  ahead = [];
}

// More is wanted again, about what the robot does now: videos of before make way, but not under the
// eyes of somebody who is at work on them.
async function lookForMore() {
  if (document.hidden || !settings.name) return;
  if (standing.enough && (await standing.refresh())) isOld = true;
  if (!isOld || busy || !ranking?.empty || performance.now() - shownAt < AT_WORK_MS) return;
  isOld = false;
  dropAhead();
  toast("There is more to rank.");
  await advance();
}

// Show the next query, as soon as there is one. answeredAt: when the person pressed save.
async function advance(answeredAt = null) {
  const mine = ++round;
  leave();
  const waits = setTimeout(showLoading, LOADING_SHOWN_MS);
  try {
    for (let tries = 0; mine === round; tries += 1) {
      if (!ahead.length && fetching) await fetching;
      const entry = mine === round ? (ahead.shift() ?? (await tryToFetch(tries))) : null;
      if (entry && mine === round) return show(entry, answeredAt);
      if (entry) ahead.push(entry);
      else if (mine === round) await pause(RETRY_MS);
    }
  } finally {
    clearTimeout(waits);
  }
}

async function tryToFetch(tries) {
  try {
    return await fetchQuery();
  } catch (error) {
    if (!(error instanceof ApiError)) throw error;
    if (error.code === "token_needed") {
      round += 1;
      unlock();
    } else if (!current) {
      showEmpty(error);
      if (tries % 5 === 0) standing.refresh();
    }
    return null;
  }
}

function leave() {
  if (current) closeSheets(current.sheets);
  current = null;
  ranking = null;
  unsure = null;
  playing.player.release();
}

function showLoading() {
  if (!current) showNothing("loading", "One moment", "The videos are on their way.");
}

function showEmpty(error) {
  const waits = error.code === "no_query";
  const title = waits ? "Nothing to rank just now" : "The page cannot go on";
  showNothing("empty", title, `${error.message} This page goes on by itself.`);
}

function showNothing(state, title, text) {
  byId("main").dataset.state = state;
  byId("empty").hidden = false;
  byId("empty-title").textContent = title;
  byId("empty-text").textContent = text;
}

// Showing

function show(entry, answeredAt = null, places = null) {
  const began = performance.now();
  current = entry;
  unsure = null;
  ranking = new Ranking(entry.query.videos.length);
  if (places) ranking.setAll(places);
  byId("empty").hidden = true;
  byId("main").dataset.state = "ready";
  playing.show(cards.show(entry.query.videos), entry.sheets);
  update();
  shownAt = performance.now();
  // In the second frame from now the first pictures are on the screen.
  requestAnimationFrame(() =>
    requestAnimationFrame(() => {
      measure("shown-to-playing", began);
      if (entry.received !== undefined) measure("query-to-playing", entry.received);
      if (answeredAt !== null) measure("submit-to-next", answeredAt);
      document.body.dataset.query = entry.query.query_id;
      fetchAhead();
    }),
  );
}

function measure(name, start) {
  performance.measure(name, { start });
}

// The order that is being made

function pick(video) {
  if (busy || !ranking || video >= ranking.count) return;
  ranking.pick(video);
  update(true);
}

function place_(video, place) {
  if (ranking && !busy) ranking.set(video, place);
  if (ranking) update(!busy);
}

function tie() {
  if (busy || !ranking) return;
  ranking.tie();
  update(true);
}

// Like every order, it is seen before it is saved.
function allEqual() {
  if (busy || !ranking) return;
  ranking.setAll(ranking.places.map(() => 1));
  update(true);
}

function back() {
  if (busy || !ranking?.back()) return;
  update(true);
}

function update(changed = false) {
  cards.update(ranking);
  byId("save").disabled = !ranking.complete;
  const words = ranking.words();
  const hint = ranking.empty
    ? "Choose the videos from best to worst."
    : `From the best: ${words}${ranking.tieNext ? " The next one ties with the last." : ""}`;
  byId("hint").textContent = hint;
  if (changed) say(ranking.complete ? `${hint} Save with Enter.` : hint);
}

let savingTimer = 0;

// While something is on its way nothing else may be done: it would meet the wrong videos.
function setBusy(value) {
  busy = value;
  byId("main").ariaBusy = value ? "true" : "false";
  clearTimeout(savingTimer);
  const name = (text) => (byId("save-name").textContent = text);
  if (value) savingTimer = setTimeout(() => name("Saving…"), SAVING_SHOWN_MS);
  else name("Save ranking");
}

// Answers

async function answer(verdict) {
  if (busy || !current || (verdict === "ranked" && !ranking.complete)) return;
  setBusy(true);
  const began = performance.now();
  const body = {
    ranking_id: newId(),
    query_id: current.query.query_id,
    annotator: settings.name,
    verdict,
    ranks: verdict === "ranked" ? ranking.ranks() : [],
    response_s: Math.min(86400, (began - shownAt) / 1000),
  };
  let stored = null;
  try {
    stored = await store(body);
  } catch (error) {
    if (!(error instanceof ApiError)) throw error;
    if (error.status === 409) await replace(error);
    else toast(`Not saved. ${error.message}`);
  } finally {
    setBusy(false);
  }
  if (!stored) return;
  if (standing.show(stored.standing) || isOld) dropAhead();
  isOld = false;
  hideToast();
  byId("undo").disabled = false;
  say("Saved. Next videos.");
  answered += 1;
  if (answered % REFRESH_EVERY === 0) standing.refresh();
  await advance(began);
}

// Sent again, an answer is the same; when the order was changed meanwhile, the first one is made
// sure of and then corrected.
async function store(body) {
  if (unsure && unsure.verdict === body.verdict && `${unsure.ranks}` === `${body.ranks}`) {
    return send(unsure);
  }
  if (unsure) {
    await send(unsure);
    body.replaces = unsure.ranking_id;
  }
  return send(body);
}

async function send(body) {
  try {
    const stored = await post("/api/rankings", body);
    if (body.replaces) session.dropAnswer(body.replaces);
    session.addAnswer(settings.name, body.ranking_id);
    undoing = null;
    return stored;
  } catch (error) {
    if (error.status === 0 || error.status >= 500) unsure = body; // it may have arrived
    throw error;
  }
}

// The query cannot be answered any more: it was answered elsewhere, or the server was restarted.
// Ask for it again; the order made so far stays where it is given again.
async function replace(error) {
  const before = current;
  const { places } = ranking;
  const waiting = ahead;
  current = null;
  ahead = [];
  try {
    const entry = await fetchQuery();
    round += 1;
    for (const { sheets } of [before, ...waiting]) closeSheets(sheets);
    const isSame = entry.query.query_id === before.query.query_id;
    toast(isSame ? "The server had lost sight of these videos. Please save once more." : `Not saved: ${error.message}`);
    show(entry, null, isSame ? places : null);
  } catch (failure) {
    if (!(failure instanceof ApiError)) throw failure;
    current = before;
    ahead = waiting;
    toast(`Not saved. ${error.message}`);
  }
}

async function undo() {
  if (busy || !settings.name) return;
  setBusy(true);
  // Pressed again after a lost answer it is the same undo, not a second one.
  undoing ??= { id: newId(), target: session.lastAnswer(settings.name) };
  const { id, target } = undoing;
  try {
    const body = { annotator: settings.name, page: session.page, withdrawal_id: id, ranking_id: target };
    const undone = await post("/api/undo", body);
    const sheets = await loadSheets(undone.query.videos);
    forgetUndo();
    if (current) ahead.unshift(current); // it comes again
    round += 1;
    show({ query: undone.query, sheets }, null, undone.verdict === "ranked" ? undone.ranks : null);
    standing.show(undone.standing);
    toast("Your last answer is taken back.");
    say(`Your last answer is taken back. ${byId("hint").textContent}`);
  } catch (error) {
    if (!(error instanceof ApiError)) throw error;
    if (error.status === 409) forgetUndo();
    toast(error.status === 409 ? "There is nothing to take back." : `Not taken back. ${error.message}`);
  } finally {
    setBusy(false);
  }

  function forgetUndo() {
    undoing = null;
    session.dropAnswer(target);
  }
}

// Who

function begin() {
  dropAhead();
  undoing = null;
  showName();
  if (!settings.helped) {
    settings.helped = true;
    openHelp();
  }
  advance();
  standing.refresh();
}

function start() {
  setUpTheme();
  setUpDialogs(begin);
  const actions = {
    save: () => answer("ranked"),
    undecided: () => answer("undecided"),
    skip: () => answer("skipped"),
    equal: allEqual,
    undo,
  };
  for (const [id, action] of Object.entries(actions)) byId(id).addEventListener("click", action);
  setUpKeys({
    ...actions,
    pick,
    tie,
    back,
    replay: () => playing.replay(),
    togglePlaying: () => playing.toggle(),
    stepFrames: (count) => playing.step(count),
    changeSpeed: (by) => playing.changeSpeed(by),
    help: openHelp,
  });
  // Enough for now is not enough for good: more is asked about what the robot then does.
  setInterval(lookForMore, ENOUGH_LOOK_MS);
  document.addEventListener("visibilitychange", lookForMore);
  if (!settings.name) return askName();
  showName();
  advance();
  standing.refresh();
}

start();
