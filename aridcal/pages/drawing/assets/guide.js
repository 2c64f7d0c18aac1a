"use strict";
// The live page of `aridcal guide`: asks its server what to show, and says what the user wants; see aridcal/runs/guide_server.py.
(() => {
  const by = (id) => document.getElementById(id);
  const { key } = document.body.dataset;
  let have = "";
  let sure = false;
  let over = false;

  function made(name, text, className) {
    const element = document.createElement(name);
    element.textContent = text;
    if (className) element.className = className;
    return element;
  }

  function digits(value) {
    return value >= 100 ? value.toFixed(0) : value.toPrecision(3);
  }

  function titled(words) {
    return words[0].toUpperCase() + words.slice(1);
  }

  function curve(known, tolerance, measured) {
    const points = known.filter((k) => k.position_mm > 0);
    const svg = by("curve");
    svg.replaceChildren();
    svg.parentElement.hidden = points.length < 2;
    if (points.length < 2) return;
    const put = (name, attributes, text) => {
      const element = document.createElementNS("http://www.w3.org/2000/svg", name);
      for (const [k, v] of Object.entries(attributes)) element.setAttribute(k, v);
      if (text !== undefined) element.textContent = text;
      svg.append(element);
    };
    const values = points.map((k) => Math.log10(k.position_mm));
    if (tolerance) values.push(Math.log10(tolerance));
    const low = Math.floor(Math.min(...values) * 3) / 3;
    const high = Math.max(Math.ceil(Math.max(...values) * 3) / 3, low + 1 / 3);
    const first = points[0].rows;
    const last = Math.max(points[points.length - 1].rows, first + 1);
    const x = (rows) => 60 + (520 * (rows - first)) / (last - first);
    const y = (mm) => 200 - (180 * (Math.log10(mm) - low)) / (high - low);
    for (let k = Math.ceil(low); k <= high; k += 1) {
      put("line", { x1: 60, x2: 580, y1: y(10 ** k), y2: y(10 ** k), stroke: "#dde2e7" });
      put("text", { x: 52, y: y(10 ** k) + 4, "text-anchor": "end" }, `${10 ** k} mm`);
    }
    put("polyline", { points: points.map((k) => `${x(k.rows)},${y(k.position_mm)}`).join(" "), fill: "none", stroke: "#0072b2", "stroke-width": 3 });
    if (tolerance) {
      put("line", { x1: 60, x2: 580, y1: y(tolerance), y2: y(tolerance), stroke: "#1d242b", "stroke-dasharray": "8 5", "stroke-width": 2 });
      put("text", { x: 580, y: y(tolerance) + 16, "text-anchor": "end" }, `tolerance ${tolerance} mm`);
    }
    put("text", { x: 60, y: 222 }, `${first} ${measured}`);
    put("text", { x: 580, y: 222, "text-anchor": "end" }, `${last} ${measured}`);
  }

  function show(state) {
    const row = state.last;
    const { measured } = state;
    by("subject").textContent = `${titled(state.subject)} is known to`;
    by("last").textContent = measured === "images" ? "Last image, by its first row" : "Last row";
    by("against").textContent = `Known against ${measured}`;
    by("so-far").textContent = `${titled(measured)} and alarms so far`;
    const known = state.known[state.known.length - 1];
    const alarm = state.alarms[state.alarms.length - 1];
    by("row").textContent = row ? `${row.ok ? "✓" : "✗"} ${row.row} ${row.ok ? "good" : "not used"}` : "none yet";
    by("row").className = `large ${row ? (row.ok ? "good" : "bad") : ""}`;
    by("row-why").textContent = row ? row.reasons.join("; ") : `waiting for ${state.table}`;
    by("known").textContent = known ? `${digits(known.position_mm)} mm` : "?";
    const tolerance = state.tolerance_mm ? `; asked: ${digits(state.tolerance_mm)} mm` : "";
    const more = known && known.more ? `; about ${known.more} ${measured} more` : "";
    const turn = known && known.rotation_mrad !== null ? `${digits(known.rotation_mrad)} mrad, ` : "";
    by("known-more").textContent = known
      ? `${turn}after ${known.rows} ${measured}, in 95 % of the region with 95 % confidence${tolerance}${more}`
      : "three poses that differ are needed before anything can be said";
    const lately = alarm && row && alarm.after >= row.row - 1;
    by("alarm").hidden = !lately || Boolean(state.stop);
    if (lately) by("alarm").replaceChildren(made("h2", `⚠ ${alarm.what}`), made("p", alarm.words), made("p", `Do: ${alarm.do}`));
    by("following").hidden = !state.next;
    if (state.next) {
      const joints = { ...state.next.joints, ...(state.next.measure || {}) };
      by("joints").replaceChildren(
        ...Object.entries(joints).map(([name, value]) => {
          const pair = document.createElement("div");
          pair.append(made("dt", state.units[name] ? `${name}, ${state.units[name]}` : name), made("dd", typeof value === "number" ? String(Number(value.toFixed(4))) : value));
          return pair;
        }),
      );
      by("why").textContent = state.next.why;
    }
    by("stop").hidden = !state.stop;
    if (state.stop) {
      over = true;
      const list = document.createElement("ol");
      for (const pose of state.stop.check) {
        list.append(made("li", Object.entries(pose).map(([name, value]) => `${name} ${Number(value.toFixed(4))}`).join(", ")));
      }
      by("stop").replaceChildren(
        made("h2", state.stop.why === "asked" ? "■ Stopped, as you asked" : `■ Enough: ${state.stop.why}`),
        made("p", state.stop.words),
        made("p", state.report || "The full search is running."),
        made("p", "Poses that check the result:"),
        list,
      );
    }
    by("alarms").replaceChildren(...state.alarms.map((a) => made("li", `${a.what}, row ${a.row}: ${a.words}. Do: ${a.do}`)).reverse());
    by("rows").replaceChildren(
      ...state.rows.map((r) => made("li", `${r.ok ? "✓" : "✗"} row ${r.row} ${r.ok ? "good" : "not used"} ${r.reasons.join("; ")}`)).reverse(),
    );
    curve(state.known, state.tolerance_mm, measured);
  }

  async function look() {
    try {
      const answer = await fetch(`state?have=${have}`);
      if (answer.status === 200) {
        const state = await answer.json();
        have = state.number;
        show(state);
      }
      by("live").textContent = "● live";
    } catch {
      by("live").textContent = over ? "aridcal guide has ended" : "✗ no connection to aridcal guide";
    }
    setTimeout(look, 300);
  }

  function say(word) {
    fetch("say", { method: "POST", headers: { "X-Key": key }, body: word }).catch(() => {});
  }

  function end() {
    by("sure").hidden = sure;
    if (sure) say("stop");
    sure = !sure;
  }

  by("reject").addEventListener("click", () => say("reject"));
  by("end").addEventListener("click", end);
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || over) return;
    if (event.key === "s") end();
    else if (sure && event.key !== "Enter") {
      sure = false;
      by("sure").hidden = true;
    }
    if (event.key === "r") say("reject");
  });
  look();
})();
