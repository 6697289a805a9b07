"use strict";
// Plays a motion: convex bodies as outlines, the farthest first, and lines from link to link.
const motion = JSON.parse(document.getElementById("motion").textContent);
const canvas = document.querySelector("canvas"), button = document.querySelector("button.play");
const slider = document.querySelector("input"), clock = document.querySelector("output.clock");
const marks = [...document.querySelectorAll(".ranges .found")], values = [...document.querySelectorAll(".ranges output")];
const period = (motion.turns.length - 1) / motion.rate, duration = period * motion.repeats;
let azimuth = -0.9, height = 0.35, time = 0, playing = false, before = null;

/** Between two arrays of numbers, however deep they are. */
const between = (a, b, share) => (Array.isArray(a) ? a.map((x, k) => between(x, b[k], share)) : a + share * (b - a));

/** An array's value at a time within all periods. */
function at(frames, now) {
  const place = Math.min((now >= duration ? period : now % period) * motion.rate, frames.length - 1);
  const first = Math.min(Math.floor(place), frames.length - 2);
  return between(frames[first], frames[first + 1], place - first);
}

/** A point of a body in the world. */
const placed = (p, turn, origin) => [0, 1, 2].map((k) => origin[k] + turn[3 * k] * p[0] + turn[3 * k + 1] * p[1] + turn[3 * k + 2] * p[2]);

/** A point of the world on the canvas: right, down, and how near it is. */
function seen(p) {
  const [x, y, z] = p.map((value, k) => value - motion.centre[k]);
  const right = -Math.sin(azimuth) * x + Math.cos(azimuth) * y, away = Math.cos(azimuth) * x + Math.sin(azimuth) * y;
  const up = Math.cos(height) * z - Math.sin(height) * away;
  const scale = 0.42 * Math.min(canvas.width, canvas.height) / motion.reach;
  return [canvas.width / 2 + scale * right, canvas.height / 2 - scale * up, Math.cos(height) * away + Math.sin(height) * z];
}

/** The convex hull of points on the canvas (Andrew's monotone chain). */
function hull(points) {
  const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  const side = (run) => {
    const chain = [];
    for (const p of run) {
      while (chain.length > 1) {
        const [a, b] = chain.slice(-2);
        if ((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) > 0) break;
        chain.pop();
      }
      chain.push(p);
    }
    return chain.slice(0, -1);
  };
  return sorted.length < 3 ? sorted : [...side(sorted), ...side([...sorted].reverse())];
}

/** Draw the robot at the time that is shown. */
function draw() {
  const style = getComputedStyle(document.documentElement), color = (name) => style.getPropertyValue(name);
  const context = canvas.getContext("2d");
  const ratio = window.devicePixelRatio || 1;
  canvas.width = canvas.clientWidth * ratio;
  canvas.height = canvas.clientHeight * ratio;
  const turns = at(motion.turns, time), origins = at(motion.origins, time);
  const shapes = motion.around.map((points) => ({ points: points.map(seen), fill: "--tick" }));
  motion.bodies.forEach((own, k) => own.forEach((points) => {
    shapes.push({ points: points.map((p) => seen(placed(p, turns[k], origins[k]))), fill: "--inertias" });
  }));
  const nearness = (shape) => shape.points.reduce((sum, p) => sum + p[2], 0) / shape.points.length;
  shapes.sort((a, b) => nearness(a) - nearness(b));
  const line = (points, closed) => {
    context.beginPath();
    points.forEach((p, k) => (k ? context.lineTo(p[0], p[1]) : context.moveTo(p[0], p[1])));
    if (closed) context.closePath();
  };
  for (const shape of shapes) {
    line(hull(shape.points), true);
    context.globalAlpha = 0.55;
    context.fillStyle = color(shape.fill);
    context.fill();
    context.globalAlpha = 1;
    context.strokeStyle = color("--ink");
    context.lineWidth = 0.6 * ratio;
    context.stroke();
  }
  context.lineWidth = 2 * ratio;
  context.strokeStyle = color("--after");
  motion.above.forEach((above, k) => {
    if (above < 0) return;
    line([seen(origins[above]), seen(origins[k])], false);
    context.stroke();
  });
  at(motion.positions, time).forEach((position, k) => {
    const [low, high] = motion.ranges[k];
    marks[k].style.left = `${(100 * (position - low) / (high - low)).toFixed(2)}%`;
    values[k].textContent = position.toFixed(3);
  });
  clock.textContent = `${time.toFixed(1)} of ${duration.toFixed(1)} s`;
  slider.value = String(time / duration);
}

/** Go on while it plays. */
function step(now) {
  if (playing) {
    time = before === null ? time : time + (now - before) / 1000;
    if (time >= duration) time = 0;
    before = now;
    requestAnimationFrame(step);
  } else {
    before = null;
  }
  draw();
}

/** Play or pause. */
function play(whether) {
  playing = whether;
  button.textContent = playing ? "Pause" : "Play";
  if (playing) requestAnimationFrame(step);
}

button.addEventListener("click", () => play(!playing));
slider.addEventListener("input", () => {
  play(false);
  time = Number(slider.value) * duration;
  draw();
});
let held = null;
canvas.addEventListener("pointerdown", (event) => {
  held = [event.clientX, event.clientY];
  canvas.setPointerCapture(event.pointerId);
});
canvas.addEventListener("pointermove", (event) => {
  if (!held) return;
  azimuth -= 0.01 * (event.clientX - held[0]);
  height = Math.max(-1.5, Math.min(1.5, height + 0.01 * (event.clientY - held[1])));
  held = [event.clientX, event.clientY];
  draw();
});
canvas.addEventListener("pointerup", () => { held = null; });
window.addEventListener("resize", draw);
draw();
