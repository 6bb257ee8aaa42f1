// Light or dark as set in the system, until the reader changes it; the choice is stored if the browser allows it.
const THEMES = ["", "light", "dark"];
const themeButton = document.getElementById("theme");
themeButton.closest("li").hidden = false;
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
}

themeButton.addEventListener("click", () => {
  const now = document.documentElement.dataset.theme ?? "";
  const next = THEMES[(THEMES.indexOf(now) + 1) % THEMES.length];
  themeKept.write(next);
  applyTheme(next);
});
applyTheme(THEMES.includes(themeKept.read()) ? themeKept.read() : "");
