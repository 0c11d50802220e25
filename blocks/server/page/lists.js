/** The lists of blocks, signals and faults, and the search: all of the drawing for who has no mouse, or does not see it. */
import { choose } from "./chooser.js";
import { anew, element, fill, keeper } from "./elements.js";

const SHOWN = 300;

/** Let the arrow keys move the focus among the buttons of a list, of which one is a stop of the Tab key. */
export function roving(list) {
  list.onkeydown = (event) => {
    const items = [...list.querySelectorAll("button")];
    const at = items.indexOf(document.activeElement);
    const to = { ArrowDown: at + 1, ArrowUp: at - 1, Home: 0, End: items.length - 1 }[event.key];
    if (to === undefined || !items[to]) return;
    event.preventDefault();
    items[to].focus();
  };
  list.addEventListener("focusin", ({ target }) => list.querySelectorAll("button").forEach((item) => (item.tabIndex = item === target ? 0 : -1)));
}

export function start(app) {
  const place = document.getElementById("lists");
  const filter = element("input", { type: "search", placeholder: "Filter", "aria-label": "Filter the lists", oninput: () => show() });
  const group = (title, open) => {
    const count = element("span", { class: "count" });
    const list = element("ul", { class: "items", "aria-label": title });
    const shown = element("details", { open }, element("summary", {}, element("h2", {}, title), count), list);
    roving(list);
    return { list, count, shown };
  };
  const groups = { faults: group("Faults", true), blocks: group("Blocks", true), signals: group("Signals", true) };
  place.append(filter, ...Object.values(groups).map(({ shown }) => shown));

  const fits = (...texts) => texts.some((text) => text.toLowerCase().includes(filter.value.trim().toLowerCase()));
  const keep = keeper();
  /** Show some entries. item: makes one of them. */
  const put = ({ list, count }, entries, item) => {
    const focused = list.contains(document.activeElement) ? [...list.children].indexOf(document.activeElement.closest("li")) : -1;
    const items = entries.slice(0, SHOWN).map((one) => keep([one, app.state.level, filter.value], () => item(one)));
    const more = entries.length - SHOWN;
    fill(list, more > 0 ? [...items, element("li", { class: "more" }, `${more} more: use the filter`)] : items);
    const buttons = [...list.querySelectorAll("button")];
    const first = buttons.find((one) => one.ariaCurrent) ?? buttons[0];
    buttons.forEach((one) => (one.tabIndex = one === first ? 0 : -1));
    if (focused >= 0 && !list.contains(document.activeElement)) (list.children[focused]?.querySelector("button") ?? first ?? filter).focus();
    count.textContent = entries.length;
  };

  /** Whether a signal is of a block, or an input or output, of the level. */
  const isHere = (name, prefix) => name.startsWith(prefix) && name.slice(prefix.length).split(".").length <= 2;
  const blockItem = (block) => {
    const name = block.path.split(".").pop();
    const opens = block.kind === "diagram";
    const onclick = () => app.reveal(block.path).then(() => app.announce(`${name}, ${block.type}, selected`));
    const onkeydown = (event) => opens && event.key === "ArrowRight" && app.open(block.path);
    const made = element(
      "button", { "data-path": block.path, ondblclick: () => opens && app.open(block.path), onclick, onkeydown },
      element("span", { class: "name" }, filter.value ? block.path : name), element("span", { class: "type" }, opens ? `${block.type} ›` : block.type),
    );
    return element("li", {}, made);
  };
  const show = () => {
    const { document: told, level } = app.state;
    if (!told) return;
    const blocks = told.blocks.filter((one) => (filter.value ? fits(one.path, one.type) : one.level === level));
    put(groups.blocks, blocks, blockItem);
    const prefix = level ? `${level}.` : "";
    const signals = told.signals.filter((one) => (filter.value ? fits(one.name) : isHere(one.name, prefix)));
    put(groups.signals, signals, (one) => {
      const shape = one.shape.length ? `[${one.shape.join("×")}]` : "";
      const open = () => app.selectWire(one.name);
      const title = told.editing ? `Select ${one.name}; a double click shows it in a scope` : `Show ${one.name} in a scope`;
      return element("li", {}, element("button", { "data-signal": one.name, title, onclick: open, ondblclick: () => app.openScope([one.name]) },
        element("span", { class: "name" }, (filter.value ? one.name : one.name.slice(prefix.length)) + shape), element("span", { class: "unit" }, one.unit)));
    });
    mark();
    groups.faults.shown.hidden = !told.faults.length;
    put(groups.faults, told.faults, (one) => element("li", {}, element("button", {
      class: one.warning ? "warning" : "fault", onclick: () => (one.block ? app.reveal(one.block) : app.announce("This fault is of no block.")),
    }, element("b", {}, one.code), ` ${one.place}: ${one.message}`, element("span", { class: "cure" }, one.cure)), app.remedy?.(one) ?? null));
    keep.round();
  };
  let waiting = 0;
  /** Once for all that comes together, and after the drawing was painted. */
  const soon = () => {
    clearTimeout(waiting);
    waiting = setTimeout(() => anew("lists", show), 0);
  };
  app.on("document", soon);
  app.on("level", soon);
  let picked = [];
  const isCurrent = (path) => path === app.state.selected || picked.includes(path);
  const mark = () => groups.blocks.list.querySelectorAll("button").forEach((one) => (one.ariaCurrent = isCurrent(one.dataset.path) ? "true" : null));
  app.on("select", mark);
  app.on("picked", (paths) => {
    picked = paths;
    mark();
  });

  // --- search ---
  /** What a word finds: names that begin with it first. */
  const found = (word) => {
    const { blocks, signals } = app.state.document;
    const entries = [
      ...blocks.map((one) => ({ name: one.path, told: one.type, go: () => app.reveal(one.path) })),
      ...signals.map((one) => ({ name: one.name, told: one.unit ? `signal, ${one.unit}` : "signal", go: () => app.selectWire(one.name) })),
    ];
    const rank = ({ name, told }) => {
      const own = name.toLowerCase();
      if (own.split(".").pop().startsWith(word)) return 0;
      return own.includes(word) ? 1 : told.toLowerCase().includes(word) ? 2 : 3;
    };
    return entries.map((one) => [rank(one), one]).filter(([order]) => order < 3).sort(([a], [b]) => a - b).slice(0, 12).map(([, one]) => one);
  };
  app.search = () =>
    choose(app, { label: "Search blocks and signals", placeholder: "Block, type or signal", find: (text) => found(text.toLowerCase()) });
  document.addEventListener("keydown", (event) => {
    const isSlash = event.key === "/" && !event.target.closest("input, textarea, dialog");
    if (!isSlash && !(event.key.toLowerCase() === "k" && (event.ctrlKey || event.metaKey))) return;
    event.preventDefault();
    if (!document.querySelector("dialog.search") && app.state.document) app.search();
  });
  app.keys.push(["/ or Ctrl+K", "search blocks and signals"], ["↑ ↓ Home End", "move in a list; Enter selects, → opens a subdiagram"]);
}
