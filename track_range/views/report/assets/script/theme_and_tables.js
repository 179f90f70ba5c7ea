// Theme of the page, and tables sorted by a click on a heading.
// ---- theme ----

function startTheme() {
  const button = byId("theme");
  const themes = ["system", "light", "dark"];
  let chosen = "system";
  try {
    chosen = localStorage.getItem("track-range-theme") || "system";
  } catch { /* without local storage (some browsers, for local files) the choice is lost when the page is closed */ }
  const show = () => {
    if (chosen === "system") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = chosen;
    button.textContent = `Theme: ${chosen}`;
  };
  button.hidden = false;
  button.addEventListener("click", () => {
    chosen = themes[(themes.indexOf(chosen) + 1) % themes.length];
    try {
      localStorage.setItem("track-range-theme", chosen);
    } catch { /* as above */ }
    show();
  });
  show();
}

// ---- tables ----

function startSorting(table) {
  const headings = [...table.tHead.rows[0].cells];
  headings.forEach((heading, index) => {
    const button = element("button", { type: "button" }, heading.textContent);
    heading.replaceChildren(button);
    heading.setAttribute("aria-sort", "none");
    button.addEventListener("click", () => {
      const isUp = heading.getAttribute("aria-sort") !== "ascending";
      headings.forEach((other) => other.setAttribute("aria-sort", "none"));
      heading.setAttribute("aria-sort", isUp ? "ascending" : "descending");
      sortRows(table.tBodies[0], index, isUp ? 1 : -1);
    });
  });
}

function sortRows(body, index, sign) {
  const key = (row) => row.cells[index].textContent.trim();
  const isEmpty = (text) => text === "-" || text === "";
  const compare = (a, b) => {
    if (isEmpty(a) || isEmpty(b)) return isEmpty(a) - isEmpty(b); // values that were not measured stay at the bottom
    const numbers = [parseFloat(a), parseFloat(b)];
    return sign * (numbers.some(Number.isNaN) ? a.localeCompare(b) : numbers[0] - numbers[1]);
  };
  body.append(...[...body.rows].sort((a, b) => compare(key(a), key(b))));
}
