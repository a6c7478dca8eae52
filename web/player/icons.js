// Icons of buttons as SVG, drawn for this project on a grid of 24.
const icon = (body) =>
  `<svg viewBox="0 0 24 24" width="20" height="20" fill="none" stroke="currentColor" stroke-width="1.8" stroke-linecap="round" stroke-linejoin="round" aria-hidden="true">${body}</svg>`;

export const ICONS = {
  play: icon('<path d="M8 5.5v13l10.5-6.5z" fill="currentColor"/>'),
  pause: icon('<path d="M8.5 6v12M15.5 6v12" stroke-width="3"/>'),
  loop: icon('<path d="M6 9h10a3 3 0 0 1 3 3M18 15H8a3 3 0 0 1-3-3M8.5 6 5.5 9l3 3M15.500 12l3 3-3 3"/>'),
  wireframe: icon('<path d="M12 4 4.500 17.500h15zM12 4v13.500M4.500 17.500l7.500-5 7.500 5"/>'),
  overlay: icon('<circle cx="9.500" cy="12" r="5.500"/><circle cx="14.500" cy="12" r="5.500" stroke-dasharray="2.500 2.500"/>'),
  follow: icon('<circle cx="12" cy="12" r="3"/><path d="M4 8V4h4M20 8V4h-4M4 16v4h4M20 16v4h-4"/>'),
  joints: icon('<circle cx="12" cy="5" r="2.200"/><circle cx="7" cy="13" r="2.200"/><circle cx="16" cy="19" r="2.200"/><path d="M10.900 6.900 8.200 11.100M8.800 14.200l5.500 3.600"/>'),
  reset: icon('<path d="M5 12a7 7 0 1 0 2.500-5.400M5 4.500V8h3.500"/>'),
  theme: icon('<circle cx="12" cy="12" r="8"/><path d="M12 4a8 8 0 0 1 0 16z" fill="currentColor"/>'),
  help: icon('<path d="M9 9.200a3 3 0 1 1 4.600 2.500c-1 .7-1.600 1.200-1.600 2.300M12 17.500v.01"/>'),
  info: icon('<path d="M12 11v6M12 7.200v.01"/><circle cx="12" cy="12" r="8.500"/>'),
  download: icon('<path d="M12 4v10.500M7.500 10.500 12 15l4.500-4.500M5 19.500h14"/>'),
};
