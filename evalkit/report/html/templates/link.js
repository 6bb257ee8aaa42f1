// The state of the page in the address, so that a copied link shows the same view: #place?word=text,text&word=text
const KEPT = ["only", "find", "open"]; // words of the whole page; all others belong to the player at the place

const link = {
  place: "",
  words: new Map(),

  // A link keeps the filter and the opened folds, and sets what it names.
  read() {
    const [place, given] = location.hash.slice(1).split("?");
    link.place = decoded(place);
    const pairs = given ? given.split("&").map((word) => word.split("=")) : [];
    const brought = new Map(pairs.map(([word, texts = ""]) => [word, texts.split(",").map(decoded).filter(Boolean)]));
    const kept = [...link.words].filter(([word]) => KEPT.includes(word));
    link.words = new Map([...kept, ...brought]);
    if (brought.has("open")) refold(brought.get("open"));
    if (location.hash) unfold(); // the target, and once more after the layout has changed
    document.dispatchEvent(new Event("linked"));
  },

  // ``words``: lists of texts by name; undefined removes a word.
  write(words, place = link.place) {
    if (place !== link.place) link.words = new Map([...link.words].filter(([word]) => KEPT.includes(word)));
    link.place = place;
    for (const [word, texts] of Object.entries(words)) {
      if (texts === undefined) link.words.delete(word);
      else link.words.set(word, texts);
    }
    const parts = [...link.words].map(([word, texts]) => `${word}=${texts.map(encodeURIComponent).join(",")}`);
    const hash = place || parts.length ? `#${encodeURIComponent(place)}${parts.length ? `?${parts.join("&")}` : ""}` : "";
    if (hash !== location.hash) history.replaceState(null, "", hash || location.pathname + location.search);
  },
};

// The folds that exist, with their initial state.
const folds = new Map();

function register(root) {
  for (const fold of root.querySelectorAll("details[id]")) if (!folds.has(fold)) folds.set(fold, fold.hasAttribute("open"));
}

function refold(named) {
  for (const id of named) {
    const fold = located(id);
    if (folds.has(fold)) fold.open = !folds.get(fold);
  }
}

document.addEventListener("built", ({ detail }) => register(detail));
document.addEventListener("toggle", ({ target }) => {
  if (printing) return;
  if (target.matches(".part")) { // a sequence is a place
    if (target.open && !folds.get(target) && !target.contains(document.getElementById(link.place))) link.write({}, target.id);
    return;
  }
  const turned = [...folds].filter(([fold, first]) => fold.open !== first && !fold.matches(".part")).map(([fold]) => fold.id);
  link.write({ open: turned.length ? turned : undefined });
}, true);
addEventListener("hashchange", link.read);
