"use strict";
// Saves a figure or its numbers as a file; without this script the page has no buttons and lacks nothing else.
(() => {
  const rules = JSON.parse(document.getElementById("figure-rules").textContent);
  const namespace = "http://www.w3.org/2000/svg";

  // The figure in the light theme, its colours in its elements, so that it needs no style sheet and no page.
  function standalone(drawn) {
    const copy = drawn.cloneNode(true);
    const [, , width, height] = copy.getAttribute("viewBox").split(" ");
    const ground = document.createElementNS(namespace, "rect");
    copy.removeAttribute("style");
    for (const sized of [copy, ground]) {
      sized.setAttribute("width", width);
      sized.setAttribute("height", height);
    }
    ground.setAttribute("class", "page");
    copy.prepend(ground);
    if (copy.querySelector(".zero")) {
      const defs = document.createElementNS(namespace, "defs");
      defs.append(document.getElementById("hatch").cloneNode(true));
      copy.prepend(defs);
    }
    for (const [selector, attributes] of rules) {
      for (const element of copy.querySelectorAll(selector)) {
        for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
      }
    }
    return `<?xml version="1.0" encoding="UTF-8"?>\n${new XMLSerializer().serializeToString(copy)}\n`;
  }

  const contents = {
    svg: (figure) => [standalone(figure.querySelector("svg")), "image/svg+xml"],
    csv: (figure) => [figure.querySelector("pre").textContent.replaceAll("\n", "\r\n"), "text/csv;charset=utf-8"],
  };

  function save(button) {
    const figure = button.closest("figure");
    const [text, type] = contents[button.value](figure);
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([text], { type }));
    link.download = `${figure.dataset.file}.${button.value}`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60000);
  }

  for (const files of document.querySelectorAll(".files")) {
    files.hidden = false;
    for (const button of files.querySelectorAll("button")) button.addEventListener("click", () => save(button));
  }
})();
