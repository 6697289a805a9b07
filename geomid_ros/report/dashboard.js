"use strict";
// Follows the node. All that comes from outside becomes text, never markup.
const WORDS = { ok: "running", warning: "warning", error: "error", stale: "silent" };
const CLASSES = { ok: "no-gap", warning: "incomplete", error: "unexplained", stale: "incomplete" };
const MOST = 600; // instants that are remembered of each line
const SILENT = 4000; // [ms] after which the node is said to be silent
const place = (id) => document.getElementById(id);
const past = new Map(); // what a line was, by its name: [time, value, low, high]
let heard = 0, connected = false;

/** An element with attributes and content, which is text or elements. */
function make(tag, attributes, ...content) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...content);
  return element;
}

const digits = (value, count = 4) => (value === null || value === undefined ? "—" : value.toPrecision(count));
const cell = (...content) => make("td", {}, ...content);
const row = (name, ...cells) => make("tr", {}, make("th", { scope: "row" }, name), ...cells);
const lines = (texts) => texts.flatMap((text, k) => (k ? [make("br", {}), text] : [text]));

/** Mass, deviation or end of an interval with as many digits as the deviation is worth. */
function measured(value, link) {
  if (value === null) return "—";
  const places = link.std > 0 ? 1 - Math.floor(Math.log10(link.std)) : 3;
  return value.toFixed(Math.min(Math.max(places, 0), 9));
}

/** Remember a value, and draw what it was since the page is open, with its interval. */
function drawn(name, value, low = value, high = value) {
  const values = past.get(name) ?? [];
  past.set(name, values);
  if (value !== null && value !== undefined) values.push([heard, value, low ?? value, high ?? value]);
  if (values.length > MOST) values.shift();
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  for (const [key, text] of Object.entries({ class: "spark", viewBox: "0 0 100 20", preserveAspectRatio: "none", role: "img", "aria-label": `${name} over time` })) svg.setAttribute(key, text);
  if (values.length < 2) return svg;
  const bottom = Math.min(...values.map((v) => v[1])), top = Math.max(...values.map((v) => v[1]));
  const room = 0.3 * (top - bottom) + 0.02 * Math.abs(top) + 1e-12;
  const [first, last] = [values[0][0], values.at(-1)[0]];
  const x = (v) => (100 * (v[0] - first)) / Math.max(last - first, 1);
  const y = (number) => Math.min(Math.max(20 - (20 * (number - bottom + room)) / (top - bottom + 2 * room), -20), 40);
  const points = (list, k) => list.map((v) => `${x(v).toFixed(2)},${y(v[k]).toFixed(2)}`).join(" ");
  for (const [kind, text] of [["polygon", `${points(values, 2)} ${points([...values].reverse(), 3)}`], ["polyline", points(values, 1)]]) {
    const shape = document.createElementNS("http://www.w3.org/2000/svg", kind);
    shape.setAttribute("points", text);
    svg.append(shape);
  }
  return svg;
}

/** A bar from `low` to `high` with a dot on an axis that ends at `end`. */
function range(link, end) {
  const share = (value) => `${(100 * Math.min(Math.max(value, 0), end)) / end}%`;
  const track = make("td", { class: "track" });
  if (link.low !== null) {
    const interval = make("span", { class: "interval" });
    interval.style.left = share(link.low);
    interval.style.width = `${(100 * (Math.min(link.high, end) - Math.min(link.low, end))) / end}%`;
    track.append(interval);
  }
  if (link.mass !== null) {
    const dot = make("span", { class: "found" });
    dot.style.left = share(link.mass);
    track.append(dot);
  }
  return row(link.name, track);
}

function showLinks(links) {
  const heaviest = Math.max(1e-9, ...links.map((link) => link.mass ?? 0));
  const end = 1.05 * Math.max(heaviest, Math.min(Math.max(...links.map((link) => link.high ?? 0)), 3 * heaviest));
  place("scale").textContent = links.length ? `Masses from 0 to ${end.toPrecision(3)} kg.` : "No estimate yet.";
  place("ranges").replaceChildren(...links.map((link) => range(link, end)));
  place("links").replaceChildren(...links.map((link) => row(
    link.merged ? `${link.name} + ${link.merged}` : link.name,
    cell(link.std === null ? measured(link.mass, link) : `${measured(link.mass, link)} ± ${measured(link.std, link)}`),
    cell(link.low === null ? "—" : `${measured(link.low, link)} to ${measured(link.high, link)}`),
    cell(drawn(`mass of ${link.name}`, link.mass, link.low, link.high)),
    cell(link.from_data === null ? "—" : `${Math.round(100 * link.from_data)} %`),
    cell(link.distance === null ? "—" : link.distance.toFixed(2)),
    make("td", { class: "words" }, link.cannot_tell || "nothing"),
  )));
}

function showChannels(channels) {
  place("channels").replaceChildren(...channels.map((channel) => row(
    channel.name, cell(digits(channel.rms)), cell(digits(channel.sigma)), cell(digits(channel.gap, 3)),
    cell(drawn(`RMS of ${channel.name}`, channel.rms)),
  )));
}

function showTopics(topics) {
  const counted = (pairs) => lines((pairs ?? []).map(([reason, count]) => `${count}: ${reason}`));
  const number = (text) => make("td", { class: "number" }, text ?? "0");
  place("topics").replaceChildren(...topics.map((topic) => row(
    topic.name, number(topic.received), number(topic.accepted),
    cell(...counted([...(topic.rejected ?? []), ...(topic.dropped ?? [])])), cell(...counted(topic.noted)), number(topic.lost),
  )));
}

const pairs = (list) => list.flatMap(([key, value]) => [make("dt", {}, key), make("dd", {}, value || "—")]);

function showOthers(others) {
  place("others").replaceChildren(...others.flatMap((other) => [
    make("h2", {}, other.name), make("p", {}, `${WORDS[other.level]}: ${other.message}`), make("dl", {}, ...pairs(other.values)),
  ]));
}

function showVerdict(level, word, message) {
  const verdict = place("verdict");
  verdict.className = `verdict ${CLASSES[level]}`;
  verdict.replaceChildren(make("strong", {}, word), make("span", {}, message));
}

function show(state) {
  heard = Date.now();
  showVerdict(state.level, WORDS[state.level], state.message);
  showLinks(state.links);
  showChannels(state.channels);
  showOthers(state.others);
  showTopics(state.topics);
  place("numbers").replaceChildren(...pairs(state.numbers));
  document.querySelector("main").hidden = false;
}

setInterval(() => {
  const silent = Date.now() - heard;
  if (heard && silent > SILENT) showVerdict("stale", WORDS.stale, connected ? "The node is silent. The data below are outdated." : "The dashboard has ended. The data below are outdated.");
  place("heard").textContent = heard ? `Last update ${(silent / 1000).toFixed(0)} s ago.` : connected ? "" : "No connection.";
}, 1000);

const events = new EventSource("events");
events.addEventListener("open", () => { connected = true; });
events.addEventListener("error", () => { connected = false; });
events.addEventListener("message", (event) => show(JSON.parse(event.data)));
