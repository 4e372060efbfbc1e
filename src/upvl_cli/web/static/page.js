"use strict";
// Comfort alone: every form works without this file.
(() => {
  const slider = document.getElementById("threshold");
  if (!slider) return;
  const shown = document.getElementById("threshold-value");
  const chart = slider.form.querySelector("svg");
  const bars = [...chart.querySelectorAll(".bar")];
  const line = chart.querySelector("line.threshold");
  const left = Number(chart.dataset.left), width = Number(chart.dataset.width);
  const show = () => {
    const value = Number(slider.value);
    shown.textContent = value.toFixed(2);
    for (const bar of bars) bar.classList.toggle("faded", Number(bar.dataset.upper) <= value);
    for (const end of ["x1", "x2"]) line.setAttribute(end, (left + value * width).toFixed(1));
  };
  slider.addEventListener("input", show);
  // A pointer that lets go is done; the keyboard moves in steps, and Enter or the button applies them.
  slider.addEventListener("pointerup", () => setTimeout(() => slider.form.requestSubmit(), 0));
  slider.addEventListener("keydown", (event) => {
    if (event.key === "Enter") slider.form.requestSubmit();
  });
})();
