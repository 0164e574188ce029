"""The style sheet of every page."""

from __future__ import annotations

STYLE = """
:root { --ink: #1b1f24; --soft: #57606a; --line: #d8dee4; --paper: #fff; --wash: #f6f8fa; }
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; scroll-behavior: smooth; }
body { margin: 0 auto; max-width: 1080px; padding: 0 20px 60px; background: var(--paper);
  color: var(--ink); overflow-wrap: anywhere;
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, Helvetica, Arial, sans-serif; }
header { padding: 28px 0 6px; }
.kicker { margin: 0; color: var(--soft); font-size: 14px; letter-spacing: .04em; }
h1 { margin: 2px 0 0; font-size: 30px; line-height: 1.2; }
h2 { margin: 44px 0 12px; padding-top: 14px; border-top: 1px solid var(--line); font-size: 21px;
  line-height: 1.3; }
h3 { margin: 20px 0 6px; font-size: 17px; }
p, ul, ol { margin: 8px 0; max-width: 76ch; }
code { font: .92em/1.4 ui-monospace, SFMono-Regular, Menlo, Consolas, "DejaVu Sans Mono", monospace;
  background: var(--wash); border-radius: 4px; padding: 1px 4px; }
nav { display: flex; flex-wrap: wrap; gap: 4px 16px; padding: 10px 0 4px; font-size: 14px; }
a { color: #0550ae; }
nav a { padding: 4px 0; }
.banner { margin: 16px 0; padding: 16px 20px; border-radius: 10px; border: 1px solid;
  border-left-width: 8px; }
.banner p { max-width: none; margin: 0; }
.banner .word { color: var(--soft); }
.banner .word b { display: inline-block; margin-right: 10px; font-size: 20px; color: inherit;
  text-transform: capitalize; }
.banner .sentence { margin-top: 6px; font-size: 18px; line-height: 1.45; }
.adequate { background: #eaf6f1; border-color: #00795a; }
.adequate .word b { color: #005f47; }
.deficient { background: #fdf1e8; border-color: #b84f00; }
.deficient .word b { color: #963f00; }
.undecided { background: #f3f3f7; border-color: #5f6073; }
.undecided .word b { color: #444559; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(240px, 100%), 1fr));
  gap: 12px; margin: 16px 0; }
.card { border: 1px solid var(--line); border-radius: 10px; padding: 12px 16px; min-width: 0; }
.card dt { color: var(--soft); font-size: 14px; }
.card dd { margin: 2px 0 0; font-size: 22px; font-weight: 600; line-height: 1.3;
  font-variant-numeric: tabular-nums; }
.card small { font-size: 14px; font-weight: 400; }
.card .rest { font-size: 14px; font-weight: 400; color: var(--soft); }
.notice { padding: 10px 16px 10px 34px; background: #fff8d6; border: 1px solid #d8b400;
  border-radius: 10px; max-width: none; }
.cause { border: 1px solid var(--line); border-radius: 10px; padding: 4px 18px 10px;
  margin: 12px 0; }
.cause h3 { margin-top: 12px; }
.facts { color: var(--soft); }
.advice { border-left: 4px solid #0072b2; padding: 2px 0 2px 16px; margin: 16px 0; }
.advice h3 { margin-top: 4px; }
.table { margin: 12px 0; border: 1px solid var(--line); border-radius: 10px; overflow: hidden; }
.caption { margin: 0; max-width: none; padding: 8px 9px; color: var(--soft); font-size: 14px;
  line-height: 1.4; background: var(--wash); }
.scroll { overflow-x: auto; background:
  linear-gradient(90deg, #fff 30%, #fff0) 0 0 / 40px 100% no-repeat local,
  linear-gradient(270deg, #fff 30%, #fff0) 100% 0 / 40px 100% no-repeat local,
  linear-gradient(90deg, #0003, #0000) 0 0 / 12px 100% no-repeat scroll,
  linear-gradient(270deg, #0003, #0000) 100% 0 / 12px 100% no-repeat scroll, #fff; }
.scroll:focus-visible { outline: 2px solid #0550ae; outline-offset: -2px; }
table { border-collapse: collapse; width: 100%; font-size: 14px; line-height: 1.4; }
th, td { padding: 6px 9px; text-align: left; vertical-align: top; border-top: 1px solid
  var(--line); overflow-wrap: break-word; min-width: 4ch; max-width: 44ch; }
th { font-weight: 600; vertical-align: bottom; }
td:last-child:not(.n) { min-width: 11ch; }
.n { text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums; }
th.n { white-space: normal; }
td code { background: none; padding: 0; }
.status { white-space: nowrap; }
.status::before { content: ""; display: inline-block; width: 10px; height: 10px; margin-right: 6px;
  border: 1px solid #444; border-radius: 2px; background: #f0e442; }
.status.named { font-weight: 600; }
.status.named::before { background: #0072b2; }
.status.cannot-be-rejected::before { background: #e69f00; }
.status.rejected::before { background: #8a8a8a; }
.status.not-significant::before { background: #cfcfcf; }
.status.invisible::before { background: #fff; }
.equations { overflow-x: auto; margin: 12px 0; }
.equations > div { margin: 10px 0; }
.equations .name { display: inline-block; min-width: 9ch; margin-right: 12px; color: var(--soft); }
.equations .unit { margin-left: 18px; color: var(--soft); }
.equations math { font-size: 1.1em; }
.new { color: #0550ae; }
.lines { font-size: 14px; max-width: none; padding-left: 28px; }
figure { margin: 16px 0; }
.plot { width: 100%; overflow: hidden; }
figcaption { color: var(--soft); font-size: 14px; max-width: 90ch; margin-top: 4px; }
@media (max-width: 620px) {
  body { padding: 0 14px 40px; }
  header { padding-top: 16px; }
  h1 { font-size: 25px; }
  .banner { padding: 12px 14px; }
  .banner .sentence { font-size: 17px; }
  .cause { padding: 2px 12px 8px; }
  th, td { max-width: 34ch; }
  table { width: max-content; min-width: 100%; }
  figure { margin: 12px -6px; }
  figcaption { margin-left: 6px; }
}
@media print {
  body { max-width: none; padding: 0; font-size: 11pt; }
  nav { display: none; }
  h2 { break-after: avoid; margin-top: 24px; }
  .card, .cause, .banner, figure, tr { break-inside: avoid; }
  .table { overflow: visible; }
  .scroll { overflow: visible; background: none; }
  .n, .status { white-space: normal; }
  table { font-size: 9pt; }
}
"""
