// Draws the equations of a page once it is there; they stand between \( and \), or \[ and \].
document.addEventListener("DOMContentLoaded", () => {
  for (const each of document.querySelectorAll(".arithmatex")) {
    renderMathInElement(each, { throwOnError: true });
  }
});
