// tables that are wider than the page say so
const wide = () => { for (const t of document.querySelectorAll(".wide")) t.classList.toggle("scrolls", t.scrollWidth > t.clientWidth + 1); };
addEventListener("resize", wide);
wide();
