/** A field whose words choose among entries, as the search and the insertion of blocks do. */
import { counted, dialog, element } from "./elements.js";

const LEAST = 6; // pixels before a press is a drag

/**
 * Open it; `refresh` asks anew for what is found. find: the entries for a text, each with name, what is told of it, picture, the group that it is listed under,
 * why it cannot be chosen, go, and drop: what is done where it is dragged out of the list, to a place of the drawing.
 * @param {{label: string, placeholder: string, text?: string, find: (text: string) => any[]}} asked
 */
export function choose(app, { label, placeholder, text = "", find }) {
  let entries = [];
  let at = 0;
  const options = element("ul", { id: "found", role: "listbox", "aria-label": "Found" });
  const word = element("input", {
    role: "combobox", "aria-expanded": "true", "aria-controls": "found", "aria-autocomplete": "list", "aria-label": label,
    placeholder, autocomplete: "off", spellcheck: "false",
  });
  let items = [];
  const mark = () => {
    items.forEach((one, index) => (one.ariaSelected = String(index === at)));
    items[at]?.scrollIntoView({ block: at ? "nearest" : "end" });
    word.setAttribute("aria-activedescendant", entries.length ? `found${at}` : "");
  };
  const take = (index) => {
    const chosen = entries[index];
    if (!chosen) return app.announce("No match.");
    if (chosen.why) return app.announce(`${chosen.name}: ${chosen.why.replace(/\.$/, "")}.`);
    shown.close();
    document.getElementById("view").focus();
    chosen.go();
  };
  /** Follow the pointer with a picture of an entry until it is let go. */
  const drag = ({ why, drop }) => (down) => {
    if (why || !drop || down.button || down.pointerType === "touch") return;
    const picture = down.currentTarget.querySelector("svg").cloneNode(true);
    const off = new AbortController();
    picture.classList.add("dragged");
    const move = ({ clientX, clientY }) => {
      if (!picture.isConnected && Math.hypot(clientX - down.clientX, clientY - down.clientY) < LEAST) return;
      if (shown.open) shown.close();
      if (!picture.isConnected) document.body.append(picture);
      Object.assign(picture.style, { left: `${clientX}px`, top: `${clientY}px` });
    };
    const end = (event) => {
      off.abort();
      if (!picture.isConnected) return;
      picture.remove();
      if (event.type === "pointerup" && document.elementFromPoint(event.clientX, event.clientY)?.closest("#view")) drop(event);
    };
    document.addEventListener("pointermove", move, off);
    document.addEventListener("pointerup", end, off);
    document.addEventListener("pointercancel", end, off);
    document.addEventListener("keydown", (event) => event.key === "Escape" && end(event), off);
  };
  word.oninput = () => {
    entries = find(word.value.trim(), word.value);
    at = 0;
    items = entries.map(({ name, told, picture, why }, index) =>
      element("li", { role: "option", id: `found${index}`, "aria-disabled": why ? "true" : null, onclick: () => take(index), onpointerdown: drag(entries[index]) },
        picture?.() ?? null, element("span", { class: "name" }, name), element("span", { class: "type" }, why || told)));
    options.replaceChildren(...items.flatMap((item, index) => {
      const { group } = entries[index];
      return group && group !== entries[index - 1]?.group ? [element("li", { role: "presentation", class: "group" }, group), item] : [item];
    }));
    mark();
    app.announce(`${counted(entries.length, "match").replace(/hs$/, "hes")}`);
  };
  word.onkeydown = (event) => {
    if (event.key === "Enter") take(at);
    else if (event.key === "ArrowDown") at = Math.min(at + 1, entries.length - 1);
    else if (event.key === "ArrowUp") at = Math.max(at - 1, 0);
    else return;
    event.preventDefault();
    mark();
  };
  const shown = dialog(label, word, options);
  shown.classList.add("search");
  word.value = text;
  word.oninput();
  return { refresh: () => shown.isConnected && word.oninput(), close: () => shown.close() };
}

/** Ask for a text, of several lines where asked so; null where none was given. @returns {Promise<string | null>} */
export function prompted(label, value = "", lines = 0) {
  return new Promise((resolve) => {
    const field = element(lines ? "textarea" : "input", { "aria-label": label, autocomplete: "off", spellcheck: "false", ...(lines ? { rows: lines, cols: 60 } : { size: 40 }) });
    field.value = value;
    let said = null;
    const shown = dialog(label, element("label", {}, `${label} `, field), " ", element("button", { onclick: () => done() }, "OK"));
    const done = () => {
      said = field.value.trim();
      shown.close();
    };
    field.onkeydown = ({ key, ctrlKey, metaKey }) => void (key === "Enter" && (!lines || ctrlKey || metaKey) && done());
    shown.addEventListener("close", () => resolve(lines ? said : said || null));
    field.select();
  });
}
