// tables that are wider than the page say so
const wide = () => { for (const t of document.querySelectorAll(".wide")) t.classList.toggle("scrolls", t.scrollWidth > t.clientWidth + 1); };
addEventListener("resize", wide);
wide();

// a rival lights up in the drawing where it would stand
for (const row of document.querySelectorAll("[data-lights]")) {
  const parts = JSON.parse(row.dataset.lights).flatMap(n => [...document.querySelectorAll(`[data-part="${CSS.escape(n)}"]`)]);
  const light = on => () => { for (const p of parts) p.classList.toggle("lit", on); row.classList.toggle("lit", on); };
  row.tabIndex = 0;
  for (const e of ["mouseenter", "focus"]) row.addEventListener(e, light(true));
  for (const e of ["mouseleave", "blur"]) row.addEventListener(e, light(false));
}
