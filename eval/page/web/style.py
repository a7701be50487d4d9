"""How the page looks: light and dark, wide, narrow and printed; nothing from elsewhere."""

STYLE = """
:root { color-scheme: light dark; --ink: #1b1b1b; --paper: #ffffff; --faint: #5c5c5c; --rule: #d0d0d0;
  --shade: #f4f4f4; --link: #0b57a0; --good: #0a6640; --fair: #8a5300; --bad: #b3261e; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e4e4; --paper: #16181b; --faint: #a8a8a8; --rule: #3c4046; --shade: #20242a; --link: #8ab8f0;
    --good: #6fd3a2; --fair: #f0b45c; --bad: #ff9b93; }
}
* { box-sizing: border-box; }
html { scroll-padding-top: 1rem; }
body { margin: 0 auto; padding: 1.25rem 1.25rem 4rem; max-width: 72rem; color: var(--ink); background: var(--paper);
  font: 1rem/1.55 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0.25rem 0 0.75rem; }
h2 { font-size: 1.35rem; margin: 2.5rem 0 0.75rem; padding-top: 0.75rem; border-top: 1px solid var(--rule); }
h3 { font-size: 1.1rem; margin: 1.75rem 0 0.5rem; }
h4 { font-size: 1rem; margin: 1.25rem 0 0.5rem; }
p, ul, ol { max-width: 60rem; }
a { color: var(--link); }
a:focus-visible, summary:focus-visible, .scroll:focus-visible, pre:focus-visible, video:focus-visible {
  outline: 3px solid var(--link); outline-offset: 2px; }
.skip { position: absolute; left: -99rem; }
.skip:focus { left: 1rem; top: 0.5rem; padding: 0.4rem 0.8rem; background: var(--paper); z-index: 9; }
.top, .made { margin: 0.5rem 0; font-size: 0.9rem; }
nav { margin: 1.25rem 0; padding: 0.6rem 1rem; background: var(--shade); border-radius: 4px; font-size: 0.92rem; }
nav ul { margin: 0; padding: 0; list-style: none; columns: 3 16rem; max-width: none; }
code, pre { font-family: ui-monospace, "DejaVu Sans Mono", Consolas, monospace; font-size: 0.88em; }
code { background: var(--shade); padding: 0.1em 0.3em; border-radius: 3px; overflow-wrap: anywhere; }
pre { background: var(--shade); padding: 0.7rem 0.9rem; border-radius: 4px; overflow-x: auto; }
pre code { background: none; padding: 0; }
details { margin: 0.5rem 0; }
summary { cursor: pointer; color: var(--link); width: fit-content; }
details[open] > summary { margin-bottom: 0.4rem; }
figure { margin: 1.25rem 0; }
figcaption { color: var(--faint); font-size: 0.88rem; line-height: 1.45; margin: 0.4rem 0; }
figcaption b { color: var(--ink); }
figcaption details { margin: 0; }
img, video { max-width: 100%; height: auto; background: #ffffff; border-radius: 4px; }
.formula { margin: 1.25rem 0; }
.scroll { overflow-x: auto; max-width: 100%; width: fit-content; }
table { border-collapse: separate; border-spacing: 0; font-size: 0.86rem; line-height: 1.3;
  font-variant-numeric: tabular-nums; border-top: 2px solid var(--ink); border-bottom: 2px solid var(--ink); }
th, td { padding: 0.3rem 0.6rem; text-align: left; vertical-align: bottom; background: var(--paper); }
td { white-space: nowrap; }
thead th { font-weight: 600; border-bottom: 1px solid var(--ink); min-width: 4.2rem; }
tbody tr:nth-child(even) > * { background: var(--shade); }
tr > :first-child { position: sticky; left: 0; z-index: 1; white-space: normal; min-width: min(8.5rem, 27vw);
  max-width: 38vw; }
.between td { color: var(--bad); white-space: normal; border-top: 1px solid var(--ink); position: static; }
.apart td, .apart ~ tr td { color: var(--faint); }
.overview table { font-size: 0.92rem; }
.overview td, .overview tbody th { vertical-align: middle; border-top: 1px solid var(--rule);
  padding: 0.35rem 0.55rem; }
.overview thead th { vertical-align: bottom; min-width: 0; padding: 0.3rem 0.55rem; }
.overview tbody th { font-weight: 600; max-width: 12rem; overflow-wrap: break-word; }
.overview .more { display: block; font-weight: 400; font-size: 0.85rem; }
.overview small { display: block; color: var(--faint); font-size: 0.8rem; white-space: normal; max-width: 11rem;
  line-height: 1.25; }
.mark { font-weight: 700; white-space: nowrap; }
.good { color: var(--good); } .fair { color: var(--fair); } .bad { color: var(--bad); } .none { color: var(--faint); }
.overview td:last-child { min-width: 6.5rem; }
.sketch svg { display: block; background: #ffffff; border-radius: 3px; }
@media (max-width: 75rem) {
  table { font-size: 0.78rem; }
  th, td { padding: 0.3rem 0.4rem; }
  thead th { min-width: 3.4rem; }
  .overview table { font-size: 0.85rem; }
  .overview td, .overview tbody th, .overview thead th { padding: 0.35rem 0.35rem; }
  .overview small { max-width: 9.6rem; }
}
@media (max-width: 40rem) {
  body { padding: 0.75rem 0.75rem 3rem; }
  h1 { font-size: 1.35rem; }
  .overview tbody th, .overview thead th:first-child { max-width: 7rem; min-width: 6.5rem; font-size: 0.85rem;
    padding: 0.35rem; }
  .overview small { max-width: 9rem; }
}
@page { size: A4; margin: 14mm 12mm; }
@media print {
  :root { color-scheme: light; --ink: #000; --paper: #fff; --faint: #333; --rule: #bbb; --shade: #f4f4f4;
    --link: #000; --good: #0a6640; --fair: #8a5300; --bad: #b3261e; }
  body { max-width: none; padding: 0; font-size: 10pt; }
  nav, .skip, .top { display: none; }
  section { break-before: page; }
  .first > section:only-child { break-before: auto; }
  h2 { margin-top: 0; border: 0; padding: 0; }
  h2, h3, h4, figcaption { break-after: avoid; }
  figure:not(.table), tr, .formula { break-inside: avoid; }
  img { max-height: 21cm; object-fit: contain; }
  details::details-content { content-visibility: visible; display: block; height: auto; }
  summary, video { display: none; }
  .scroll { overflow: visible; width: auto; }
  tr > :first-child { position: static; min-width: 0; }
  table { font-size: 6.5pt; }
  .overview table { font-size: 8pt; }
  .overview small, .overview .more { font-size: 6.5pt; }
  th, td, .overview td, .overview tbody th { padding: 0.12rem 0.22rem; min-width: 0; }
  thead th { min-width: 0; }
  td { white-space: normal; overflow-wrap: break-word; }
}
"""
