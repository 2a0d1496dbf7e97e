// The passes over pixels count their work: see work.rs.

const COUNTS = true;
