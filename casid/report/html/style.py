"""The style sheet of every page."""

from __future__ import annotations

STYLE = """
:root { color-scheme: light; --ink: #1b1f24; --soft: #57606a; --line: #d8dee4; --paper: #fff;
  --wash: #f6f8fa; --link: #0550ae; --good: #005f47; --good-line: #00795a; --good-wash: #eaf6f1;
  --bad: #963f00; --bad-line: #b84f00; --bad-wash: #fdf1e8; --none: #444559; --none-line: #5f6073;
  --none-wash: #f3f3f7; --note-line: #d8b400; --note-wash: #fff8d6; --advice: #0072b2;
  --shade: #0003; }
@media screen and (prefers-color-scheme: dark) {
  :root { color-scheme: dark; --ink: #d9dfe6; --soft: #9aa5b1; --line: #38414c; --paper: #14181d;
    --wash: #1d232b; --link: #79b8ff; --good: #6fd3b0; --good-line: #2f9c78; --good-wash: #12261f;
    --bad: #ffb07c; --bad-line: #d97b35; --bad-wash: #2b1d12; --none: #c3c5dc;
    --none-line: #7d80a0; --none-wash: #1f202b; --note-line: #a98d1d; --note-wash: #2a250f;
    --advice: #4aa3df; --shade: #0009; }
}
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
section:first-of-type h2, h2:first-child { margin-top: 24px; }
details.part { border-top: 1px solid var(--line); }
details.part > summary, details.fold > summary { cursor: pointer; padding: 10px 0; }
details.part > summary h2 { display: inline; margin: 0; padding: 0; border: 0; font-size: 18px; }
details.part[open] { padding-bottom: 20px; }
details.fold > summary { color: var(--link); font-size: 15px; }
summary:focus-visible { outline: 2px solid var(--link); outline-offset: 2px; }
code.id { font-size: .72em; font-weight: 400; color: var(--soft); background: none; }
h3 { margin: 20px 0 6px; font-size: 17px; }
p, ul, ol { margin: 8px 0; max-width: 76ch; }
code { font: .92em/1.4 ui-monospace, SFMono-Regular, Menlo, Consolas, "DejaVu Sans Mono", monospace;
  background: var(--wash); border-radius: 4px; padding: 1px 4px; }
a { color: var(--link); }
.banner { margin: 16px 0; padding: 16px 20px; border-radius: 10px; border: 1px solid;
  border-left-width: 8px; }
.banner p { max-width: none; margin: 0; }
.banner .word { color: var(--soft); }
.banner .word b { display: inline-block; margin-right: 10px; font-size: 20px; color: inherit; }
.banner .word b::first-letter { text-transform: uppercase; }
.banner .sentence { margin-top: 6px; font-size: 18px; line-height: 1.45; }
.adequate { background: var(--good-wash); border-color: var(--good-line); }
.adequate .word b { color: var(--good); }
.deficient { background: var(--bad-wash); border-color: var(--bad-line); }
.deficient .word b { color: var(--bad); }
.undecided { background: var(--none-wash); border-color: var(--none-line); }
.undecided .word b { color: var(--none); }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(240px, 100%), 1fr));
  gap: 12px; margin: 16px 0; }
.card { border: 1px solid var(--line); border-radius: 10px; padding: 12px 16px; min-width: 0; }
.card dt { color: var(--soft); font-size: 14px; }
.card dd { margin: 2px 0 0; font-size: 22px; font-weight: 600; line-height: 1.3;
  font-variant-numeric: tabular-nums; }
.card small { font-size: 14px; font-weight: 400; }
.card .rest { font-size: 14px; font-weight: 400; color: var(--soft); }
.notice { padding: 10px 16px 10px 34px; background: var(--note-wash);
  border: 1px solid var(--note-line);
  border-radius: 10px; max-width: none; }
.cause { border: 1px solid var(--line); border-radius: 10px; padding: 4px 18px 10px;
  margin: 12px 0; }
.cause h3 { margin-top: 12px; }
.facts { color: var(--soft); }
.advice { border-left: 4px solid var(--advice); padding: 2px 0 2px 16px; margin: 16px 0; }
section div.advice h2 { margin: 4px 0 6px; padding: 0; border: 0; font-size: 17px; }
.table { margin: 12px 0; border: 1px solid var(--line); border-radius: 10px; overflow: hidden; }
.caption { margin: 0; max-width: none; padding: 8px 9px; color: var(--soft); font-size: 14px;
  line-height: 1.4; background: var(--wash); }
.scroll { overflow-x: auto; background:
  linear-gradient(90deg, var(--paper) 30%, transparent) 0 0 / 40px 100% no-repeat local,
  linear-gradient(270deg, var(--paper) 30%, transparent) 100% 0 / 40px 100% no-repeat local,
  linear-gradient(90deg, var(--shade), transparent) 0 0 / 12px 100% no-repeat scroll,
  linear-gradient(270deg, var(--shade), transparent) 100% 0 / 12px 100% no-repeat scroll,
  var(--paper); }
.scroll:focus-visible, .equations:focus-visible {
  outline: 2px solid var(--link); outline-offset: -2px; }
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
.status.undetectable::before { background: #fff; }
.equations { overflow-x: auto; margin: 12px 0; }
.equations > div { margin: 10px 0; }
.equations .name { display: inline-block; min-width: 9ch; margin-right: 12px; color: var(--soft); }
.equations .unit { margin-left: 18px; color: var(--soft); }
.equations math { font-size: 1.1em;
  font-family: 'Latin Modern Math', 'STIX Two Math', 'Cambria Math', 'DejaVu Math TeX Gyre', math; }
.new { color: var(--link); }
.lines { font-size: 14px; max-width: none; padding-left: 28px; }
figure { margin: 16px 0; }
.plot { width: 100%; overflow: hidden; }
.plot .modebar .modebar-btn { min-width: 24px; min-height: 24px; }
.plot .modebar-btn:focus-visible, .plot .legendtoggle:focus-visible {
  outline: 2px solid var(--link) !important; outline-offset: -2px; }
.choice { display: block; font-size: 14px; }
.choice select { font: inherit; max-width: 100%; color: var(--ink); background: var(--paper);
  border: 1px solid var(--soft); border-radius: 4px; padding: 3px 6px; }
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
@page { size: A4; margin: 15mm; }
@media print {
  .modebar { display: none !important; }
  summary, h3 { break-after: avoid; }
  details.part > summary, details.fold > summary { list-style: none; }
  details::details-content { content-visibility: visible; height: auto; }
  body { max-width: none; padding: 0; font-size: 11pt; }
  h2 { break-after: avoid; margin-top: 24px; }
  .card, .cause, .banner, figure, tr { break-inside: avoid; }
  .table { overflow: visible; }
  .scroll { overflow: visible; background: none; }
  .n, .status { white-space: normal; }
  table { font-size: 9pt; }
}
"""
