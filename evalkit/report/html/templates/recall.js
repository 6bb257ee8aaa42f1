// The state of a player as lists of texts by word, for links, and its restoration from a link.
const PICKS = { by: "first", and: "second", on: "map", colour: "quantity", correction: "correction", side: "side" };
const WORST = ["a", "b", "by"];

function playerState(player) {
  const { view, recording, state } = player;
  const pick = (name) => player.find(`select[data-picks=${name}]`)?.value;
  return {
    scan: [String(recording.numbers[state.scan])],
    ...Object.fromEntries(Object.entries(PICKS).map(([word, name]) => [word, [pick(name)].filter(Boolean)])),
    layers: player.all("input[data-layer]").filter((box) => box.checked).map((box) => box.dataset.layer),
    shown: player.all("input.shows").filter((box) => box.checked).map((box) => box.value),
    worst: WORST.map((name) => player.find(`select[data-worst=${name}]`)?.value).filter(Boolean),
    // centre and width of the view (m), independent of the window's size
    view: view.touched ? [view.x, view.y, view.size[0] / view.scale].map((value) => value.toFixed(3)) : [],
  };
}

// The scan and the method that places it, and every other word that differs from the initial state.
function different(now, first) {
  const same = ([word, texts]) => !["scan", "by"].includes(word) && JSON.stringify(texts) === JSON.stringify(first[word]);
  return Object.fromEntries(Object.entries(now).map((entry) => [entry[0], same(entry) ? undefined : entry[1]]));
}

// Words missing in a link keep their initial state; unknown values are ignored.
function restore(player, words) {
  const wanted = { ...player.first, ...Object.fromEntries(words) };
  const pick = (select, value) => {
    if (select && [...select.options].some((option) => option.value === value)) select.value = value;
  };
  if (!Object.keys(player.first).some((word) => words.has(word))) return;
  for (const [word, name] of Object.entries(PICKS)) pick(player.find(`select[data-picks=${name}]`), wanted[word][0] ?? "");
  WORST.forEach((name, i) => pick(player.find(`select[data-worst=${name}]`), wanted.worst[i]));
  for (const box of player.all("input[data-layer]")) box.checked = wanted.layers.includes(box.dataset.layer);
  for (const box of player.all("input.shows")) box.checked = wanted.shown.includes(box.value);
  player.choose();
  const [x, y, width] = wanted.view.map(Number);
  if (width > 0) Object.assign(player.view, { x, y, scale: player.view.size[0] / width, touched: true });
  else player.home();
  const { numbers } = player.recording;
  const number = Number(wanted.scan[0]);
  const nearest = numbers.reduce((best, one, i) => (Math.abs(one - number) < Math.abs(numbers[best] - number) ? i : best), 0);
  player.go(Number.isNaN(number) ? player.state.scan : nearest);
  player.kept = JSON.stringify(playerState(player));
}
