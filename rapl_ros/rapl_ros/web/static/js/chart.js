// Two small charts in SVG: points over steps, and one stem an episode.

const SPACE = "http://www.w3.org/2000/svg";
const LEFT = 46;
const RIGHT = 12;
const TOP = 10;
const BOTTOM = 24;

function element(name, attributes, text) {
  const made = document.createElementNS(SPACE, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

function canvas(holder, title) {
  const width = Math.max(200, holder.clientWidth);
  const height = Math.max(100, holder.clientHeight);
  const svg = element("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": title });
  holder.replaceChildren(svg);
  return { svg, width, height };
}

function short(value) {
  if (Math.abs(value) >= 1000) return `${+(value / 1000).toPrecision(3)}k`;
  return `${+value.toPrecision(3)}`;
}

// Round numbers from low to high, some four of them.
function ticks(low, high, count = 4) {
  const rough = (high - low) / count || 1;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough);
  const found = [];
  for (let n = Math.ceil(low / step - 1e-9); n * step <= high + step * 1e-9; n += 1) found.push(n * step);
  return found;
}

function nothing({ svg, width, height }, text) {
  svg.append(element("text", { x: width / 2, y: height / 2, "text-anchor": "middle", class: "nothing" }, text));
}

function horizontal({ svg, width }, y, label) {
  svg.append(
    element("line", { x1: LEFT, x2: width - RIGHT, y1: y, y2: y, class: "grid-line" }),
    element("text", { x: LEFT - 10, y: y + 4, "text-anchor": "end" }, label),
  );
}

// evaluations, running: [{steps, success_rate}]
export function drawSuccess(holder, evaluations, running, summary) {
  const frame = canvas(holder, `Success by steps. ${summary}`);
  const known = (points) => points.filter(({ success_rate: rate }) => rate !== null);
  const [measured, faint] = [known(evaluations), known(running)];
  if (!measured.length && !faint.length) {
    nothing(frame, "Nothing has been learnt yet");
    return;
  }
  const most = Math.max(1, ...measured.map((p) => p.steps), ...faint.map((p) => p.steps));
  const x = (steps) => LEFT + (steps / most) * (frame.width - LEFT - RIGHT);
  const y = (rate) => TOP + (1 - rate) * (frame.height - TOP - BOTTOM);
  for (const rate of [0, 0.5, 1]) horizontal(frame, y(rate), `${rate * 100} %`);
  const marks = ticks(0, most);
  for (const steps of marks) {
    const isLast = steps === marks.at(-1);
    const anchor = steps === 0 ? "start" : x(steps) > frame.width - 60 ? "end" : "middle";
    frame.svg.append(
      element("text", { x: x(steps), y: frame.height - 4, "text-anchor": anchor }, `${short(steps)}${isLast ? " steps" : ""}`),
    );
  }
  const path = (points) => points.map((p, i) => `${i ? "L" : "M"}${x(p.steps)} ${y(p.success_rate)}`).join("");
  if (faint.length > 1) frame.svg.append(element("path", { d: path(faint), class: "line faint" }));
  if (measured.length > 1) frame.svg.append(element("path", { d: path(measured), class: "line" }));
  for (const point of measured) {
    frame.svg.append(element("circle", { cx: x(point.steps), cy: y(point.success_rate), r: 4, class: "point" }));
  }
}

// rewards: [{total, valid, purpose}], the newest last
export function drawRewards(holder, rewards, summary) {
  const frame = canvas(holder, `Reward of the last episodes. ${summary}`);
  const totals = rewards.filter(({ valid }) => valid).map(({ total }) => total);
  if (!rewards.length) {
    nothing(frame, "No episode has been rewarded yet");
    return;
  }
  const step = ticks(Math.min(0, ...totals), Math.max(0, ...totals), 3);
  const size = step.length > 1 ? step[1] - step[0] : 1;
  const low = Math.floor(Math.min(0, ...totals) / size) * size;
  const high = Math.ceil(Math.max(0, ...totals) / size) * size;
  const span = high - low || 1;
  const y = (value) => TOP + ((high - value) / span) * (frame.height - TOP - BOTTOM);
  for (const value of ticks(low, high, 3)) horizontal(frame, y(value), short(value));
  const room = (frame.width - LEFT - RIGHT) / Math.max(20, rewards.length);
  rewards.forEach(({ total, valid, purpose }, index) => {
    const x = LEFT + (index + 0.5) * room;
    if (!valid) {
      frame.svg.append(element("circle", { cx: x, cy: y(0) + 8, r: 3.5, class: "bad" }));
      return;
    }
    const kind = purpose === "evaluate" ? "stem evaluate" : "stem";
    frame.svg.append(element("line", { x1: x, x2: x, y1: y(0), y2: y(total), class: kind, "stroke-width": Math.min(6, room * 0.55) }));
  });
  frame.svg.append(
    element("text", { x: LEFT, y: frame.height - 4 }, "older"),
    element("text", { x: frame.width - RIGHT, y: frame.height - 4, "text-anchor": "end" }, "newest"),
  );
}
