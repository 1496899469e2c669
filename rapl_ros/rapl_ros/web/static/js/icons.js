// Small drawings, made of paths in a square of 24.

const PATHS = {
  play: [["M8 5.5v13l10.5-6.5z", "fill"]],
  pause: [["M7 5.5h3.5v13H7zM13.5 5.5H17v13h-3.5z", "fill"]],
  replay: [["M5 12a7 7 0 1 0 2.4-5.3M5 4.5v4h4", "stroke"]],
  light: [
    ["M12 8.2a3.8 3.8 0 1 0 0 7.6 3.8 3.8 0 0 0 0-7.6z", "stroke"],
    ["M12 3v2M12 19v2M3 12h2M19 12h2M5.6 5.6 7 7M17 17l1.4 1.4M18.4 5.6 17 7M7 17l-1.4 1.4", "stroke"],
  ],
  dark: [["M19.5 14.2A8 8 0 0 1 9.8 4.5a8 8 0 1 0 9.7 9.7z", "stroke"]],
  auto: [
    ["M12 4a8 8 0 1 0 0 16 8 8 0 0 0 0-16z", "stroke"],
    ["M12 4a8 8 0 0 1 0 16z", "fill"],
  ],
};

export function icon(name) {
  const space = "http://www.w3.org/2000/svg";
  const svg = document.createElementNS(space, "svg");
  svg.setAttribute("viewBox", "0 0 24 24");
  svg.setAttribute("aria-hidden", "true");
  for (const [d, kind] of PATHS[name]) {
    const path = document.createElementNS(space, "path");
    path.setAttribute("d", d);
    path.setAttribute("fill", kind === "fill" ? "currentColor" : "none");
    if (kind === "stroke") {
      path.setAttribute("stroke", "currentColor");
      path.setAttribute("stroke-width", "1.8");
      path.setAttribute("stroke-linecap", "round");
      path.setAttribute("stroke-linejoin", "round");
    }
    svg.append(path);
  }
  return svg;
}
