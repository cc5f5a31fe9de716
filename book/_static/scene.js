// Turnable scenes: one shared viewer file, loaded only near the window, at most six alive on a page.
// Messages instead of requests, because a page opened from disk may not fetch its neighbours.
(() => {
  const MOST = 6;
  const viewer = new URL("viewer.html", document.currentScript.src).href;
  const alive = []; // stages, oldest first

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
  }

  addEventListener("message", (event) => {
    const stage = alive.find((s) => s.querySelector("iframe").contentWindow === event.source);
    if (!stage) return;
    if (event.data === "fm-ready") {
      event.source.postMessage(stage.querySelector("script").textContent, "*");
    } else if (event.data === "fm-drawn") {
      stage.querySelector("iframe").classList.add("fm-drawn");
    }
  });

  addEventListener("DOMContentLoaded", () => {
    const near = new IntersectionObserver(
      (entries) => entries.forEach((e) => e.isIntersecting && wake(e.target)),
      { rootMargin: "200px" },
    );
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
