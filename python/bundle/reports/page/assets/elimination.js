// Steps through the elimination of a small graph: what has been eliminated is greyed, fill appears
// where it is made, and the bill runs along. Everything is drawn once; a step changes classes.
"use strict";

(() => {
  const SVG = "http://www.w3.org/2000/svg";
  const MILLISECONDS = 900;
  const SIDE = 400;
  const data = JSON.parse(document.getElementById("data").textContent).elimination;
  if (!data) return;

  const byId = (id) => document.getElementById(id);
  const slider = byId("step");
  const play = byId("play");
  const chooser = byId("run");
  const count = data.names.length;
  let run = null; // the order that is shown, with what was drawn for it
  let timer = null;

  const add = (parent, tag, attributes, words) => {
    const element = document.createElementNS(SVG, tag);
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
    if (words !== undefined) element.textContent = words;
    parent.appendChild(element);
    return element;
  };
  const plural = (number, word) => `${number.toLocaleString("en")} ${word}${number === 1 ? "" : "s"}`;
  const list = (variables) => variables.map((variable) => data.names[variable]).join(", ");

  // step[v]: after how many steps variable v is gone. An edge made by step k has born = k.
  function draw(chosen) {
    const step = new Array(count);
    chosen.order.forEach((variable, index) => (step[variable] = index + 1));
    const pairs = data.edges.map((ends) => ({ ends, born: 0 }));
    chosen.steps.forEach((made, index) => {
      for (const ends of made.fill) pairs.push({ ends, born: index + 1 });
    });
    run = { ...chosen, step, pairs, nodes: [], bands: [] };
    drawGraph(byId("graph"));
    drawMatrix(byId("matrix"));
  }

  function drawGraph(svg) {
    svg.replaceChildren();
    svg.setAttribute("viewBox", `0 0 ${SIDE} ${data.height}`);
    const at = data.positions;
    for (const pair of run.pairs) {
      const [[x1, y1], [x2, y2]] = pair.ends.map((variable) => at[variable]);
      pair.line = add(svg, "line", { class: pair.born ? "fill" : "edge", x1, y1, x2, y2 });
    }
    for (let variable = 0; variable < count; variable++) {
      const group = add(svg, "g", { class: "node" });
      const [cx, cy] = at[variable];
      add(group, "title", {}, data.names[variable]);
      add(group, "circle", { cx, cy, r: data.radius });
      add(group, "text", { x: cx, y: cy }, data.labels[variable]);
      run.nodes.push(group);
    }
  }

  function drawMatrix(svg) {
    svg.replaceChildren();
    const size = SIDE / count;
    const gap = Math.min(1, size / 8);
    for (let index = 0; index < count; index++) {
      const [row, column] = [
        { x: 0, y: index * size, width: SIDE, height: size },
        { x: index * size, y: 0, width: size, height: SIDE },
      ];
      run.bands.push([row, column].map((box) => add(svg, "rect", { class: "band", ...box })));
    }
    const cell = (row, column, born) => {
      const [x, y] = [column * size + gap / 2, row * size + gap / 2];
      const kind = born ? "cell filled" : "cell";
      return add(svg, "rect", { class: kind, x, y, width: size - gap, height: size - gap });
    };
    run.diagonal = run.order.map((_, index) => cell(index, index, 0));
    for (const pair of run.pairs) {
      const [a, b] = pair.ends.map((variable) => run.step[variable] - 1);
      pair.cells = [cell(a, b, pair.born), cell(b, a, pair.born)];
      pair.dies = Math.min(a, b) + 1;
    }
  }

  function show(done) {
    const last = done > 0 ? run.steps[done - 1] : null;
    const touched = new Set(last ? last.neighbours : []);
    run.nodes.forEach((node, variable) => {
      node.classList.toggle("eliminated", run.step[variable] <= done);
      node.classList.toggle("pivot", run.step[variable] === done);
      node.classList.toggle("touched", touched.has(variable));
    });
    for (const pair of run.pairs) {
      pair.line.classList.toggle("gone", pair.dies <= done);
      pair.line.classList.toggle("shown", pair.born <= done);
      pair.line.classList.toggle("fresh", pair.born > 0 && pair.born === done);
      for (const cell of pair.cells) {
        cell.classList.toggle("shown", pair.born <= done);
        cell.classList.toggle("eliminated", pair.dies <= done);
      }
    }
    run.diagonal.forEach((cell, index) => cell.classList.toggle("eliminated", index < done));
    run.bands.forEach((boxes, index) =>
      boxes.forEach((box) => box.classList.toggle("pivot", index === done - 1)));
    slider.value = done;
    slider.setAttribute("aria-valuetext", `step ${done} of ${count}`);
    tell(done, last);
  }

  function tell(done, last) {
    byId("where").textContent = `${done} of ${count}`;
    byId("total-fill").textContent = (last ? last.total_fill : 0).toLocaleString("en");
    byId("total-flops").textContent = (last ? last.total_flops : 0).toLocaleString("en");
    byId("sentence").textContent = last ? story(last) : beginning();
  }

  function beginning() {
    return `Order ${run.ordering}: nothing is eliminated yet. The whole elimination makes ` +
      `${plural(run.fill, "fill edge")} and costs ${plural(run.flops, "flop")}.`;
  }

  function story(last) {
    const name = data.names[last.variable];
    if (last.neighbours.length === 0) {
      return `Eliminating ${name} costs nothing: no other is left that it meets.`;
    }
    const made = last.fill.map((ends) => ends.map((end) => data.names[end]).join("-"));
    let news = `which makes ${plural(made.length, "fill edge")}: ${made.join(", ")}.`;
    if (last.neighbours.length === 1) news = "and nothing else: no fill.";
    else if (made.length === 0) news = "which all meet each other already: no fill.";
    return `Eliminating ${name} costs ${plural(last.flops, "flop")}: ` +
      `it meets ${list(last.neighbours)}, ${news}`;
  }

  function go(step) {
    show(Math.max(0, Math.min(count, step)));
  }
  function stop() {
    clearInterval(timer);
    timer = null;
    play.textContent = "Play";
  }
  function toggle() {
    if (timer !== null) return stop();
    if (Number(slider.value) >= count) go(0);
    play.textContent = "Pause";
    timer = setInterval(() => {
      go(Number(slider.value) + 1);
      if (Number(slider.value) >= count) stop();
    }, MILLISECONDS);
  }
  function move(step) {
    stop();
    go(step);
  }

  slider.addEventListener("input", () => move(Number(slider.value)));
  byId("back").addEventListener("click", () => move(Number(slider.value) - 1));
  byId("forward").addEventListener("click", () => move(Number(slider.value) + 1));
  play.addEventListener("click", toggle);
  chooser?.addEventListener("change", () => {
    stop();
    draw(data.runs[Number(chooser.value)]);
    go(Number(slider.value));
  });
  document.addEventListener("keydown", (event) => {
    const busy = event.target.closest("input, select, button, a, textarea");
    if (event.altKey || event.ctrlKey || event.metaKey || busy) return;
    const now = Number(slider.value);
    const target = { ArrowLeft: now - 1, ArrowRight: now + 1, Home: 0, End: count }[event.key];
    if (target !== undefined) move(target);
    else if (event.key === " ") toggle();
    else return;
    event.preventDefault();
  });

  slider.max = count;
  draw(data.runs[0]);
  go(0);
})();
