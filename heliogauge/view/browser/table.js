"use strict";
// Tables: sorted by a press on a head, filtered by a word; rows beyond the first are shown on demand.
(() => {
  // A filter only where there are more rows than one sees at once.
  const ROWS_TO_FILTER = 8;

  function orderOf(cell) {
    if (cell.dataset.order !== undefined) return Number(cell.dataset.order);
    return cell.classList.contains("number") ? NaN : cell.textContent.trim();
  }

  // Numbers before texts, missing ones last in both directions.
  function compare(one, other, sign) {
    const missing = (value) => value === "" || Number.isNaN(value);
    if (missing(one) || missing(other)) return missing(one) - missing(other);
    if (typeof one === "number" && typeof other === "number") return sign * (one - other);
    return sign * String(one).localeCompare(String(other), undefined, { numeric: true });
  }

  function show(section) {
    const { element } = heliogauge;
    const most = Number(section.dataset.rows);
    const body = section.querySelector("tbody");
    const rows = [...body.rows];
    const heads = [...section.querySelectorAll("thead th")];
    const name = section.getAttribute("aria-label");
    const count = element("output", { class: "view-note", "aria-live": "polite" });
    let sorted = null;

    // The first rows in the present order that the filter leaves are shown; the others when all are asked for.
    function arrange() {
      const words = filter.value.trim().toLowerCase();
      let found = 0;
      for (const row of body.rows) {
        const fits = !words || row.textContent.toLowerCase().includes(words);
        row.classList.toggle("unmatched", !fits);
        row.classList.toggle("further", fits && ++found > most);
      }
      const all = section.classList.contains("all-rows");
      const shown = all ? found : Math.min(found, most);
      count.textContent = words ? `${found} of ${rows.length} rows fit, ${shown} shown` : `${shown} of ${rows.length} rows shown`;
      more.hidden = found <= most;
      more.textContent = all ? `Show ${most}` : `Show all ${found}`;
    }

    function sort(column) {
      const descending = sorted?.column === column && !sorted.descending;
      sorted = { column, descending };
      const keyed = rows.map((row) => [orderOf(row.cells[column]), row]);
      keyed.sort(([one], [other]) => compare(one, other, descending ? -1 : 1));
      body.append(...keyed.map(([, row]) => row));
      heads.forEach((head, index) => {
        if (index === column) head.setAttribute("aria-sort", descending ? "descending" : "ascending");
        else head.removeAttribute("aria-sort");
      });
      arrange();
    }

    function showAll(on) {
      section.classList.toggle("all-rows", on);
      arrange();
    }

    const filter = element("input", { type: "search", "aria-label": `Filter ${name}`, placeholder: "Filter rows", input: arrange });
    const more = element("button", { type: "button", click: () => showAll(!section.classList.contains("all-rows")) });
    heads.forEach((head, column) => {
      const button = element("button", { type: "button", class: "view-sort", click: () => sort(column) }, ...head.childNodes);
      head.replaceChildren(button);
    });
    const bar = element("div", { class: "view-bar" }, filter, count, more);
    bar.hidden = rows.length <= ROWS_TO_FILTER && rows.length <= most;
    section.prepend(bar);
    arrange();
    return {
      open(mark) {
        const row = document.getElementById(mark);
        if (!row) return;
        filter.value = "";
        showAll(true);
        row.scrollIntoView({ block: "center" });
        row.tabIndex = -1;
        row.focus({ preventScroll: true });
      },
    };
  }

  heliogauge.kind("table", show);
})();
