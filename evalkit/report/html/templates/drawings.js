// Hides filtered methods in the figures (SVG in data URIs), including their legends.
const drawings = [...document.querySelectorAll(".pictures img[src^='data:image/svg+xml']")].map((image) => ({ image, whole: image.src }));

function withoutHidden(whole) {
  const bytes = Uint8Array.from(atob(whole.slice(whole.indexOf(",") + 1)), (letter) => letter.charCodeAt(0));
  const drawing = new DOMParser().parseFromString(new TextDecoder().decode(bytes), "image/svg+xml");
  const named = [...drawing.querySelectorAll("[id^='of:']")].filter((part) => !isShown(part.id.slice(3)));
  for (const part of named) part.setAttribute("style", "display: none"); // hidden, not removed: other texts reuse their glyphs
  return named.length ? `data:image/svg+xml,${encodeURIComponent(new XMLSerializer().serializeToString(drawing))}` : whole;
}

document.addEventListener("methods", () => {
  for (const drawing of drawings) {
    const wanted = allShown() ? drawing.whole : withoutHidden(drawing.whole);
    if (drawing.image.src !== wanted) drawing.image.src = wanted;
  }
});
