"""Style and script of report pages. Nothing is fetched: the page's own rules forbid any connection."""

from __future__ import annotations

POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; "
    "base-uri 'none'; form-action 'none'"
)
"""Content security policy: what is in the page, and nothing else."""

STYLE = """
:root { --ink: #1f2430; --soft: #5b6472; --line: #dfe3e9; --paper: #ffffff; --back: #f4f6f8; --accent: #1b6ca8; }
* { box-sizing: border-box; }
html { scroll-behavior: smooth; scroll-padding-top: 3.2rem; }
body { margin: 0; background: var(--back); color: var(--ink); line-height: 1.5;
  font-family: system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; font-size: 16px; }
main, header.top > div { max-width: 1180px; margin: 0 auto; padding: 0 20px; }
header.top { background: var(--paper); border-bottom: 1px solid var(--line); padding: 26px 0 16px; }
h1 { font-size: 1.55rem; margin: 0 0 .3rem; } h2 { font-size: 1.3rem; margin: 0; }
h3 { font-size: 1.05rem; margin: 0 0 .2rem; } h4 { font-size: .95rem; margin: 1.2rem 0 .4rem; }
p { margin: .4rem 0; } code { font-size: .86em; overflow-wrap: anywhere; }
.meta { color: var(--soft); font-size: .9rem; overflow-wrap: anywhere; }
nav { position: sticky; top: 0; z-index: 5; background: rgba(255,255,255,.96); border-bottom: 1px solid var(--line);
  overflow-x: auto; white-space: nowrap; }
nav > div { max-width: 1180px; margin: 0 auto; padding: 8px 20px; display: flex; gap: 8px; }
nav a { color: var(--ink); text-decoration: none; font-size: .88rem; padding: 3px 10px; border-radius: 999px;
  border: 1px solid var(--line); background: var(--paper); }
nav a:hover { border-color: var(--accent); }
.dot { display: inline-block; width: .62em; height: .62em; border-radius: 50%; margin-right: .4em;
  background: #8a93a3; }
.adequate .dot { background: #2e8b57; } .missing .dot, .missing_and_unknown .dot { background: #1b6ca8; }
.unknown .dot { background: #e08e0b; }
.cannot_tell .dot { background: #8a93a3; }
section.joint { margin: 26px 0 40px; }
.card { background: var(--paper); border: 1px solid var(--line); border-radius: 10px; padding: 18px 20px;
  margin: 14px 0; }
.verdict { border-left: 5px solid #8a93a3; }
.verdict.adequate { border-left-color: #2e8b57; }
.verdict.missing, .verdict.missing_and_unknown { border-left-color: #1b6ca8; }
.verdict.unknown { border-left-color: #e08e0b; }
.verdict .say { font-size: 1.12rem; font-weight: 600; margin: .2rem 0 .5rem; }
.badge { color: var(--soft); font-size: .82rem; text-transform: uppercase; letter-spacing: .05em; }
.grid { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 330px), 1fr)); gap: 14px; }
.grid.wide { grid-template-columns: repeat(auto-fit, minmax(min(100%, 430px), 1fr)); }
.figure { min-width: 0; width: 100%; }
.figure .modebar { opacity: 0 !important; } .figure:hover .modebar { opacity: .9 !important; }
table { border-collapse: collapse; width: 100%; font-size: .9rem; }
.scroll { overflow-x: auto; } th { text-align: left; color: var(--soft); font-weight: 600; }
th, td { padding: 5px 12px 5px 0; border-bottom: 1px solid var(--line); vertical-align: top; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
details { margin-top: 10px; } summary { cursor: pointer; color: var(--accent); font-size: .92rem; }
ul { margin: .3rem 0; padding-left: 1.15rem; } li { margin: .2rem 0; }
.finding { font-weight: 500; } .small { font-size: .88rem; color: var(--soft); }
@media (max-width: 600px) { main, header.top > div, nav > div { padding-left: 12px; padding-right: 12px; }
  .card { padding: 14px 12px; border-radius: 8px; } body { font-size: 15px; } h1 { font-size: 1.3rem; } }
@media print { nav { display: none; } body { background: white; } .card { break-inside: avoid; border: 0; } }
"""

SCRIPT = """
"use strict";
(() => {
  const coarse = matchMedia("(pointer: coarse)").matches;
  const root = document.documentElement;
  root.dataset.drawn = "0";
  const draw = (place) => {
    if (place.dataset.state) return;
    place.dataset.state = "drawing";
    const figure = JSON.parse(document.getElementById(place.dataset.figure).textContent);
    if (coarse) figure.layout.dragmode = false;
    const bar = coarse ? false : "hover";
    Plotly.newPlot(place, figure.data, figure.layout, { responsive: true, displaylogo: false, displayModeBar: bar })
      .then(() => { place.dataset.state = "drawn"; root.dataset.drawn = String(Number(root.dataset.drawn) + 1); });
  };
  const places = document.querySelectorAll(".figure");
  const watch = new IntersectionObserver((entries) => {
    for (const entry of entries) if (entry.isIntersecting) { watch.unobserve(entry.target); draw(entry.target); }
  }, { rootMargin: "800px 0px" });
  for (const place of places) watch.observe(place);
  const all = () => {
    for (const box of document.querySelectorAll("details")) box.open = true;
    places.forEach(draw);
  };
  addEventListener("beforeprint", all);
  if (location.hash === "#all") all();
})();
"""
"""A picture is drawn when it comes near the screen; `#all` behind the address draws everything at once."""
