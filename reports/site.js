"use strict";
// Filters what is on the page by words and choices. Without it everything is there to read.
(() => {
  const form = document.querySelector("form.find");
  if (!form) return;
  const plain = (text) => text.toLowerCase().normalize("NFKD").replace(/[\u0300-\u036f]/g, "").replace(/[_\-]/g, " ");
  const words = form.querySelector("input");
  const choices = [...form.querySelectorAll("select[data-by]")];
  const status = form.querySelector("[role=status]");
  const items = [...document.querySelectorAll("[data-find]")].map((node) => ({ node, text: plain(node.dataset.find) }));
  // Inner groups come after outer ones, and are counted on their own.
  const groups = [...document.querySelectorAll("[data-group]")];

  const update = () => {
    const asked = plain(words.value).split(/\s+/).filter(Boolean);
    const chosen = choices.filter((choice) => choice.value);
    const filtered = asked.length > 0 || chosen.length > 0;
    let shown = 0;
    for (const { node, text } of items) {
      const fits = asked.every((word) => text.includes(word)) &&
        chosen.every((choice) => node.dataset[choice.dataset.by] === choice.value);
      node.hidden = !fits;
      shown += fits;
    }
    for (const group of groups) {
      group.hidden = filtered && !group.querySelector("[data-find]:not([hidden])");
    }
    document.body.classList.toggle("filtered", filtered);
    status.textContent = filtered ? `${shown} of ${items.length} fit` : "";
  };

  form.hidden = false;
  form.addEventListener("submit", (event) => event.preventDefault());
  form.addEventListener("input", update);
  form.addEventListener("change", update);
  // A reload may keep what was typed.
  update();

  // A link to a claim shows it, whatever was filtered before.
  addEventListener("hashchange", () => {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (!target || !target.closest("[hidden]")) return;
    form.reset();
    update();
    target.scrollIntoView();
  });
  // As in many a manual, a slash goes to the search.
  addEventListener("keydown", (event) => {
    const typing = event.target instanceof Element && event.target.closest("input, select, textarea");
    if (event.key === "/" && !typing && !event.ctrlKey && !event.metaKey && !event.altKey) {
      event.preventDefault();
      words.focus();
    }
  });
})();
