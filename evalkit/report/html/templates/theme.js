// Light or dark as set in the system, until the reader changes it; the choice is stored if the browser allows it.
const THEMES = ["", "light", "dark"];
const themeButton = document.getElementById("theme");
themeButton.closest(".tool").hidden = false;
const themeKept = {
  read: () => { try { return localStorage.getItem("evalkit-theme") ?? ""; } catch { return ""; } },
  write: (theme) => { try { localStorage.setItem("evalkit-theme", theme); } catch { /* a file may be denied a memory */ } },
};

function applyTheme(theme) {
  if (theme) document.documentElement.dataset.theme = theme;
  else delete document.documentElement.dataset.theme;
  const words = { "": "as the system", light: "light", dark: "dark" }[theme];
  themeButton.textContent = { "": "◐", light: "☀", dark: "☾" }[theme];
  themeButton.setAttribute("aria-label", `Colours: ${words}. Change`);
  themeButton.title = `Colours: ${words}`;
  document.dispatchEvent(new Event("theme"));
}

themeButton.addEventListener("click", () => {
  const now = document.documentElement.dataset.theme ?? "";
  const next = THEMES[(THEMES.indexOf(now) + 1) % THEMES.length];
  themeKept.write(next);
  applyTheme(next);
});
applyTheme(THEMES.includes(themeKept.read()) ? themeKept.read() : "");
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => document.dispatchEvent(new Event("theme")));

const isDark = () => getComputedStyle(document.documentElement).getPropertyValue("--dark").trim() === "1";
// A colour of the page (var(--name)) for a canvas.
const paint = (colour) => getComputedStyle(document.documentElement).getPropertyValue(colour.slice(4, -1)).trim() || colour;
