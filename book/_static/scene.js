// Turnable scenes: one shared viewer file, loaded only near the window, at most six alive on a page.
// Messages instead of requests, because a page opened from disk may not fetch its neighbours.
(() => {
  const MOST = 6;
  const viewer = new URL("viewer.html", document.currentScript.src).href;
  const alive = []; // stages, oldest first
  const phone = matchMedia("screen and (max-width: 480px)");

  // One shape above the other on a phone, or two by two where there are many.
  function arrange(stage) {
    const [image, titles] = ["img", ".fm-titles"].map((q) => stage.querySelector(q)), panels = [...titles.children];
    const { rows, columns } = stage.dataset, [width, height] = ["width", "height"].map((a) => image.getAttribute(a));
    const shape = (width * rows) / (height * columns); // of a panel
    const across = !phone.matches ? +columns : panels.length > 4 ? 2 : 1;
    const down = phone.matches ? Math.ceil(panels.length / across) : +rows;
    const still = phone.matches && !stage.querySelector(".fm-drawn");
    image.style.visibility = phone.matches ? "hidden" : "";
    stage.style.aspectRatio = `${shape * across} / ${down}`;
    titles.style.gridTemplate = `repeat(${down}, 1fr) / repeat(${across}, 1fr)`;
    panels.forEach((panel, k) => { // its part of the still picture
      const [x, y] = [(k % columns) / (columns - 1 || 1), Math.floor(k / columns) / (rows - 1 || 1)];
      panel.style.background = still ? `url(${image.src}) ${100 * x}% ${100 * y}% / ${100 * columns}% ${100 * rows}%` : "";
    });
    return panels.map((_, k) => {
      const [x, y] = [k % across, Math.floor(k / across)];
      return [x / across, 1 - (y + 1) / down, (x + 1) / across, 1 - y / down]; // of the viewer's window, from below
    });
  }

  function wake(stage) {
    if (alive.includes(stage)) return;
    if (alive.length === MOST) sleep(alive[0]);
    const frame = document.createElement("iframe");
    frame.className = "fm-live";
    frame.title = stage.querySelector("img").alt;
    frame.src = viewer;
    stage.append(frame);
    alive.push(stage);
  }

  function sleep(stage) {
    alive.splice(alive.indexOf(stage), 1);
    stage.querySelector("iframe").remove();
    arrange(stage);
  }

  addEventListener("message", (event) => {
    const stage = alive.find((s) => s.querySelector("iframe").contentWindow === event.source);
    if (!stage) return;
    if (event.data === "fm-ready") {
      event.source.postMessage([stage.querySelector("script").textContent, arrange(stage)], "*");
    } else if (event.data === "fm-drawn") {
      stage.querySelector("iframe").classList.add("fm-drawn");
      arrange(stage);
    }
  });

  addEventListener("DOMContentLoaded", () => {
    const near = new IntersectionObserver(
      (entries) => entries.forEach((e) => e.isIntersecting && wake(e.target)),
      { rootMargin: "200px" },
    );
    const stages = document.querySelectorAll(".fm-stage");
    if (phone.matches) stages.forEach(arrange);
    phone.addEventListener("change", () => {
      [...alive].forEach(sleep);
      stages.forEach((stage) => { arrange(stage); near.unobserve(stage); if (stage.matches(":has(> script)")) near.observe(stage); });
    });
    document.querySelectorAll(".fm-stage:has(> script)").forEach((stage) => near.observe(stage));
  });
})();

// Paper is white: print the light theme, then go back.
(() => {
  const root = document.documentElement;
  let theme;
  addEventListener("beforeprint", () => {
    theme = root.dataset.theme;
    root.dataset.theme = "light";
  });
  addEventListener("afterprint", () => (root.dataset.theme = theme));
})();

// The theme lets the keyboard scroll what is too wide, but looks for it on resizing only: unfolded code counts as well.
document.addEventListener("toggle", () => dispatchEvent(new Event("resize")), true);
