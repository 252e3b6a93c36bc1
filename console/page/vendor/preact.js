// What the pages use of Preact and htm.

import htm from "./htm.module.js";
import { h } from "./preact.module.js";

export { render } from "./preact.module.js";
export { useCallback, useEffect, useLayoutEffect, useMemo, useRef, useState } from "./hooks.module.js";
export const html = htm.bind(h);
