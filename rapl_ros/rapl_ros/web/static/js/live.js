// The page that shows the system live: asks once a second, and the camera a little more often.

import { ApiError, get, getBlob, post } from "./api.js";
import { drawRewards, drawSuccess } from "./chart.js";
import { setUpTheme } from "./theme.js";

const PERIOD_MS = 1000;
const PEOPLE_PERIOD_MS = 3000;
const CAMERA_PERIOD_MS = 400;
const STAGES = ["collect", "rank", "align", "train", "evaluate", "report"];
const byId = (id) => document.getElementById(id);
const percent = (share) => `${Math.round(share * 100)} %`;

function make(name, className, ...content) {
  const element = document.createElement(name);
  if (className) element.className = className;
  element.append(...content);
  return element;
}

function showStages({ stages }) {
  const known = new Map(stages.map((stage) => [stage.name, stage]));
  const names = [...STAGES, ...[...known.keys()].filter((name) => !STAGES.includes(name))];
  // A server that came late has not heard of all: what is before a known stage is done.
  const latest = STAGES.findLastIndex((name) => known.has(name));
  byId("stages").replaceChildren(
    ...names.map((name, index) => {
      const stage = known.get(name) ?? { status: index < latest ? "done" : "to come", done: 0, total: 0 };
      const item = make("li", "", make("span", "", name));
      item.dataset.status = stage.status;
      const bar = document.createElement("progress");
      bar.max = 1;
      bar.value = stage.status === "done" ? 1 : stage.total ? stage.done / stage.total : 0;
      bar.ariaLabel = `${name}: ${stage.status}`;
      item.append(bar);
      return item;
    }),
  );
  const now = stages.findLast(({ status }) => status !== "done");
  byId("stage-note").textContent = now ? stageWords(now) : "";
}

function stageWords({ name, status, done, total, unit, remaining_s: left, detail }) {
  const words = [`${name}: ${status}`];
  if (total) words.push(`${done.toLocaleString("en")} of ${total.toLocaleString("en")} ${unit}`);
  if (left) words.push(`${left < 90 ? `${Math.round(left)} s` : `${Math.round(left / 60)} min`} left`);
  if (detail) words.push(detail);
  return words.join(" · ");
}

function showLearning({ evaluations, metrics, rewards, episodes, steps_per_s: rate }) {
  const last = evaluations.findLast(({ success_rate: success }) => success !== null);
  const words = [];
  if (last) words.push(`${percent(last.success_rate)} after ${last.steps.toLocaleString("en")} steps`);
  if (rate) words.push(`${Math.round(rate)} steps/s`);
  byId("success-note").textContent = words.join(" · ");
  drawSuccess(byId("success"), evaluations, metrics, words.join(", "));
  const valid = rewards.filter(({ valid }) => valid);
  const dropped = rewards.length - valid.length;
  const mean = valid.reduce((sum, { total }) => sum + total, 0) / (valid.length || 1);
  const facts = valid.length ? [`mean ${mean.toFixed(1)}`] : [];
  if (dropped) facts.push(`${dropped} dropped`);
  if (episodes) facts.push(`${episodes.toLocaleString("en")} episodes`);
  byId("rewards-note").textContent = facts.join(" · ");
  drawRewards(byId("rewards"), rewards, facts.join(", "));
}

function showEncoder({ encoder, encoders, align, swap }) {
  const facts = encoder
    ? [["At work", encoder.name], ["Version", encoder.version], ["Backbone", encoder.backbone], ["Preset", encoder.preset || "none"]]
    : [["At work", "none yet"]];
  byId("encoder").replaceChildren(...facts.flatMap(([term, fact]) => [make("dt", "", term), make("dd", "", fact)]));
  const select = byId("encoders");
  const held = [...select.options].map(({ value }) => value);
  if (held.join() !== encoders.join()) {
    const chosen = select.value;
    select.replaceChildren(...encoders.map((name) => new Option(name)));
    if (encoders.includes(chosen)) select.value = chosen;
  }
  showJob(swap, byId("swap"), byId("swap-said"));
  showJob(align, byId("align"), byId("align-said"));
  byId("align-bar").hidden = align.state !== "running";
  if (align.share === null) byId("align-bar").removeAttribute("value");
  else byId("align-bar").value = align.share;
}

function showJob({ state, message }, button, said) {
  button.disabled = state === "running";
  said.className = state === "failed" ? "error" : "small soft";
  if (said.textContent !== message) said.textContent = message;
}

function showNodes({ nodes }) {
  byId("nodes").replaceChildren(
    ...nodes.map(({ name, health, status, detail }) => {
      const dot = make("span", "dot");
      dot.dataset.health = health;
      const words = health === "ok" || health === "absent" ? status : health;
      const state = make("span", "state", detail ? `${words}: ${detail}` : words);
      state.title = state.textContent;
      const item = make("li", "", dot, make("span", "", name), state);
      item.dataset.health = health;
      return item;
    }),
  );
}

function showPeople({ standing, videos, agreement, agreement_pairs: pairs, annotators }) {
  const { given, wanted, needed } = standing;
  const words = [needed ? `${given} of ${wanted} given` : `${given} given`];
  if (needed) words.push(`${needed} needed`);
  words.push(`${videos} videos`);
  if (agreement !== null) words.push(`${percent(agreement)} agreement (pairs seen by two: ${pairs})`);
  byId("people-note").textContent = words.join(" · ");
  const share = (value, of) => {
    if (value === null) return make("td", "", "–");
    return make("td", "", percent(value), " ", make("span", "of", `of ${of}`));
  };
  const row = (one) => {
    const name = make("th", "", one.annotator);
    name.scope = "row";
    return make("tr", "", name, make("td", "", `${one.ranked}`), make("td", "more", `${one.undecided}`), make("td", "more", `${one.skipped}`), share(one.consistency, one.consistency_pairs), share(one.agreement, one.agreement_pairs));
  };
  byId("people").tBodies[0].replaceChildren(...annotators.map(row));
}

function showLink(error) {
  const link = byId("link");
  const text = error ? (["token_needed", "operators_only"].includes(error.code) ? "operator’s token needed" : "no connection") : "live";
  link.dataset.health = error ? "error" : "ok";
  if (link.textContent !== text) link.textContent = text;
}

async function refresh() {
  const view = await get("/api/live");
  byId("task").textContent = view.task || "The system, live";
  byId("run").textContent = view.run;
  document.title = `${view.task || "Live"} · RAPL`;
  showStages(view);
  showLearning(view);
  showEncoder(view);
  showNodes(view);
  showLink(null);
}

let pictureUrl = "";

async function refreshCamera() {
  const image = byId("camera");
  const none = byId("camera-none");
  try {
    const url = URL.createObjectURL(await getBlob("/api/camera.jpg"));
    image.src = url;
    URL.revokeObjectURL(pictureUrl);
    pictureUrl = url;
    image.hidden = false;
    none.hidden = true;
  } catch (error) {
    if (error.code !== "no_picture") throw error;
    image.hidden = true;
    none.hidden = false;
  }
}

// Repeat a refresh; not while nobody looks.
async function repeat(job, period) {
  while (true) {
    if (!document.hidden) {
      try {
        await job();
      } catch (error) {
        if (!(error instanceof ApiError)) throw error;
        if (error.status !== 503) showLink(error);
      }
    }
    await new Promise((resolve) => setTimeout(resolve, period));
  }
}

function toast(text) {
  byId("toast").textContent = text;
  byId("toast").hidden = false;
  setTimeout(() => (byId("toast").hidden = true), 6000);
}

function command(button, path, body) {
  byId(button).addEventListener("click", async () => {
    byId(button).disabled = true;
    try {
      await post(path, body());
      await refresh();
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      byId(button).disabled = false;
      toast(error.message);
    }
  });
}

setUpTheme();
command("align", "/api/align", () => ({}));
command("swap", "/api/encoder", () => ({ encoder: byId("encoders").value }));
repeat(refresh, PERIOD_MS);
repeat(async () => showPeople(await get("/api/progress")), PEOPLE_PERIOD_MS);
repeat(refreshCamera, CAMERA_PERIOD_MS);
