"use strict";
// Values under the pointer, and zooming by dragging. Without it the lines stand as they were drawn.
const WIDTH = 20000, HEIGHT = 4000;

/** The points of a path, as arrays of x and y; NaN where the line is broken. */
function points(path) {
  const x = [], y = [];
  for (const run of path.getAttribute("d").split("M").slice(1)) {
    const numbers = run.split(" ").map(Number);
    for (let k = 0; k + 1 < numbers.length; k += 2) { x.push(numbers[k]); y.push(numbers[k + 1]); }
    x.push(NaN); y.push(NaN);
  }
  return { name: path.dataset.name, x, y };
}

/** The line's height at a place, NaN where there is none. */
function heightAt(line, place) {
  for (let k = 1; k < line.x.length; k++) {
    if (line.x[k - 1] <= place && place <= line.x[k]) {
      const share = (place - line.x[k - 1]) / Math.max(line.x[k] - line.x[k - 1], 1);
      return line.y[k - 1] + share * (line.y[k] - line.y[k - 1]);
    }
  }
  return NaN;
}

/** Panels of one recording, which are zoomed together. */
function zoomable(group) {
  const traces = [...group.querySelectorAll("figure.trace")].map((figure) => ({
    figure, svg: figure.querySelector("svg"), area: figure.querySelector(".area"), readout: figure.querySelector("output"),
    times: [...figure.querySelectorAll(".times span")], cursor: figure.querySelector(".cursor"),
    unit: figure.dataset.unit, low: +figure.dataset.low, high: +figure.dataset.high, end: +figure.dataset.end, lines: null,
  }));
  const back = group.querySelector("button.whole");
  let shown = [0, WIDTH];

  /** Show this part of the recording in all panels. */
  function show(begin, end) {
    shown = [begin, end];
    for (const trace of traces) {
      trace.svg.setAttribute("viewBox", `${begin} 0 ${end - begin} ${HEIGHT}`);
      trace.times.forEach((label, k) => {
        label.textContent = (((begin + (end - begin) * k / (trace.times.length - 1)) / WIDTH) * trace.end).toPrecision(4);
      });
    }
    back.hidden = begin === 0 && end === WIDTH;
  }

  /** Where in the recording the pointer is. */
  function placeOf(trace, event) {
    const box = trace.area.getBoundingClientRect();
    const share = Math.min(Math.max((event.clientX - box.left) / box.width, 0), 1);
    return [share, shown[0] + share * (shown[1] - shown[0])];
  }

  for (const trace of traces) {
    let from = null;
    const { area, cursor, readout } = trace;
    const say = (event) => {
      const [share, place] = placeOf(trace, event);
      trace.lines ??= [...trace.svg.querySelectorAll("path")].map(points);
      const values = trace.lines.map((line) => [line.name, trace.high - (heightAt(line, place) / HEIGHT) * (trace.high - trace.low)]);
      const known = values.filter(([, value]) => Number.isFinite(value)).map(([name, value]) => `${name} ${value.toPrecision(4)}`);
      readout.textContent = `${((place / WIDTH) * trace.end).toFixed(2)} s: ${known.join(", ") || "nothing"} ${trace.unit}`;
      cursor.hidden = false;
      cursor.style.left = `${100 * share}%`;
      cursor.style.width = from === null ? "1px" : `${100 * Math.abs(share - from[0])}%`;
      if (from !== null) cursor.style.left = `${100 * Math.min(share, from[0])}%`;
    };
    area.addEventListener("pointermove", say);
    area.addEventListener("pointerdown", (event) => { from = placeOf(trace, event); area.setPointerCapture(event.pointerId); say(event); });
    area.addEventListener("pointerup", (event) => {
      if (from === null) return;
      const ends = [from[1], placeOf(trace, event)[1]].sort((a, b) => a - b);
      from = null;
      if (ends[1] - ends[0] > 0.02 * (shown[1] - shown[0]) && ends[1] - ends[0] > 20) show(...ends);
      say(event);
    });
    area.addEventListener("pointercancel", () => { from = null; });
    area.addEventListener("pointerleave", () => { if (from === null) { cursor.hidden = true; readout.textContent = ""; } });
    area.addEventListener("dblclick", () => show(0, WIDTH));
  }
  back.addEventListener("click", () => show(0, WIDTH));
}
document.querySelectorAll(".recording").forEach(zoomable);
