// The passes over pixels do not count their work.

const COUNTS = false;
