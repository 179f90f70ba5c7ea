// Start of the page.

startTheme();
document.querySelectorAll("table.sortable").forEach(startSorting);
if (content.timeline) {
  startTimeline();
  startEvents();
  startProbabilities();
  startKeys();
  byId("play").addEventListener("click", togglePlay);
  for (const button of document.querySelectorAll(".headline[data-time]"))
    button.addEventListener("click", () => seek(Number(button.dataset.time)));
  if (video) startVideo();
  startKnown();
  if (roadView) startRoad();
  if (drive) startMap();
  const follow = () => { // links such as report.html#t=12.5
    const match = /^#t=(\d+(?:\.\d+)?)$/.exec(location.hash);
    if (match) seek(Number(match[1]));
  };
  addEventListener("hashchange", follow);
  follow();
}
if (tracks.length) {
  new ResizeObserver(([{ target }]) => { // keeps scroll targets clear of the bar that stays at the top
    document.documentElement.style.setProperty("--watch", `${target.offsetHeight + 8}px`);
  }).observe(byId("watch"));
  startLegend(byId("legend"), tracks.some((track) => track.truth));
  byId("now").hidden = false;
  startList();
  showPresent();
}
if (content.errors && Object.keys(content.errors).length)
  wholeChart("error-chart", "Relative error against true distance, by method", "wide-chart", drawErrors);
if (content.lines?.length) startComparison();
content.charts?.forEach(startChart);
if (content.calibration && Object.keys(content.calibration).length)
  wholeChart("sigma-chart", "Expected and observed fraction of errors within k sigma, by method", "square-chart", drawSigma);
