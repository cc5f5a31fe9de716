// It starts by itself once it is seen, where less motion is not wished for, and rests on the last frame.
for (const f of document.querySelectorAll(".fm-moving:not([data-fm])")) {
  f.dataset.fm = "ready";
  const [frame, button, slider] = ["div", "button", "input"].map((q) => f.querySelector(q));
  const { columns, rows, time } = f.dataset, last = +slider.max;
  let timer = 0;
  const show = (k) => {
    slider.value = k;
    frame.style.backgroundPosition =
      `${(100 * (k % columns)) / (columns - 1 || 1)}% ${(100 * Math.floor(k / columns)) / (rows - 1 || 1)}%`;
  };
  const stop = () => { timer = clearInterval(timer); button.textContent = "Play"; };
  const step = () => { show(+slider.value + 1); if (+slider.value === last) stop(); };
  const play = () => {
    if (+slider.value === last) show(0);
    timer = setInterval(step, +time);
    button.textContent = "Pause";
  };
  button.onclick = () => (timer ? stop() : play());
  slider.oninput = () => { stop(); show(+slider.value); };
  if (matchMedia("(prefers-reduced-motion: reduce)").matches) continue;
  new IntersectionObserver((entries, seen) => {
    if (!entries.some((e) => e.isIntersecting)) return;
    seen.disconnect();
    if (!timer && +slider.value === last) play();
  }, { threshold: 0.9 }).observe(frame);
}
