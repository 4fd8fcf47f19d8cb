"use strict";
// Sorting, filters and search; without this script the page shows the same words and figures, in the order written.
(() => {
  const tools = document.querySelector(".tools");
  const said = tools.querySelector("output");
  const selects = [...tools.querySelectorAll("select")];
  const words = tools.querySelector("input");

  // What an element says, in lower case; computed once, when it is first asked for.
  const texts = new WeakMap();
  function textOf(element) {
    if (!texts.has(element)) texts.set(element, element.textContent.toLowerCase());
    return texts.get(element);
  }

  function value(row, index) {
    const cell = row.cells[index];
    return cell.dataset.v === undefined ? cell.textContent.trim().toLowerCase() : Number(cell.dataset.v);
  }

  // Numbers before texts, and what says "-" last, whichever way the column is sorted.
  function compare(one, other, way) {
    const empty = (one === "-") - (other === "-");
    if (empty || one === other) return empty;
    if (typeof one !== typeof other) return typeof one === "number" ? -1 : 1;
    return (one < other ? -1 : 1) * way;
  }

  // Rows of a table, each with the row below it that holds what opening it shows.
  function pairs(table) {
    const own = [...table.tBodies].flatMap((body) => [...body.rows]).filter((row) => !row.matches(".more"));
    return own.map((row) => [row, ...(row.nextElementSibling?.matches(".more") ? [row.nextElementSibling] : [])]);
  }

  function sort(head) {
    const table = head.closest("table");
    const rows = pairs(table);
    const first = rows.filter(([row]) => row.parentElement === table.tBodies[0]).length;
    const numbers = rows.some(([row]) => typeof value(row, head.cellIndex) === "number");
    const before = head.getAttribute("aria-sort");
    const descending = before ? before === "ascending" : numbers;
    for (const other of head.parentElement.cells) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", descending ? "descending" : "ascending");
    const way = descending ? -1 : 1;
    rows.sort(([a], [b]) => compare(value(a, head.cellIndex), value(b, head.cellIndex), way));
    table.tBodies[0].append(...rows.slice(0, first).flat());
    table.tBodies[1]?.append(...rows.slice(first).flat());
  }

  for (const table of document.querySelectorAll("main table")) {
    table.classList.add("cards");
    const heads = [...table.tHead.rows[0].cells];
    const titles = heads.map((head) => head.textContent);
    const own = pairs(table);
    for (const [row] of own) {
      for (const cell of row.cells) if (cell.matches("td")) cell.dataset.t = titles[cell.cellIndex];
    }
    if (own.length < 2) continue;
    for (const head of heads) {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      button.addEventListener("click", () => sort(head));
      head.append(button);
    }
  }

  const PARTS = "details:not(.row, .every, .key)";
  const sections = [...document.querySelectorAll(`main ${PARTS}`)];
  const rows = [...document.querySelectorAll("main table")].flatMap(pairs);

  function apply() {
    const wanted = selects.filter((select) => select.value);
    const looked = words.value.trim().toLowerCase();
    const other = (element) =>
      wanted.some(({ name, value }) => name in element.dataset && element.dataset[name] !== value);
    let found = 0;
    for (const section of sections) {
      const holds = textOf(section).includes(looked);
      section.classList.toggle("out", other(section) || !holds);
      found += holds && !section.querySelector(PARTS);
    }
    document.querySelector("main").classList.toggle("filtered", Boolean(looked || wanted.length));
    for (const [row, ...more] of rows) {
      // of a table that holds the words, the rows that hold them; what stands in no section is not searched
      const misses = looked && row.closest("details") && ![row, ...more].some((one) => textOf(one).includes(looked));
      const out = other(row) || Boolean(misses && textOf(row.closest("table")).includes(looked));
      for (const one of [row, ...more]) one.classList.toggle("out", out);
    }
    said.textContent = looked ? `${found} ${found === 1 ? "section has" : "sections have"} these words` : "";
  }

  let waiting = 0;
  words.addEventListener("input", () => {
    clearTimeout(waiting);
    waiting = setTimeout(apply, 150);
  });
  for (const select of selects) select.addEventListener("change", apply);
  const every = [...document.querySelectorAll("main details")];
  const all = (open) => () => every.forEach((one) => { one.open = open; });
  tools.querySelector("[name=open]").addEventListener("click", all(true));
  tools.querySelector("[name=close]").addEventListener("click", all(false));
  tools.hidden = sections.length === 0 && selects.length === 0;

  function reveal() {
    const target = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (!target) return;
    for (let at = target; at; at = at.parentElement) {
      if (at.tagName === "DETAILS") at.open = true;
      if (at.matches("tr.more")) at.previousElementSibling.querySelector("details.row").open = true;
      if (at.matches("tbody.rest")) at.closest(".table").querySelector(":scope > .every").open = true;
    }
    target.scrollIntoView();
  }
  window.addEventListener("hashchange", reveal);
  // a link to the section that the address names already changes no hash
  document.addEventListener("click", (event) => {
    const link = event.target.closest("a[href^='#']");
    if (link && link.getAttribute("href") === location.hash) reveal();
  });
  reveal();
})();
