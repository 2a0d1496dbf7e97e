// Iteration of a bucket's splats over their tile's pixels in two phases, without sums over threads:
// shared by `rasterize_backward` and `contribute`.
//
// A workgroup is a bucket. It takes the tile's blocks one after the other, and of the bucket's
// entries only those that have the block's bit, up to ROWS at a time. In phase 1 a thread is a
// pixel of the block: it meets those splats front to back, and stores two numbers for each in
// workgroup memory. In phase 2 a thread is a splat and a part of the block's pixels: it adds up
// what phase 1 stored for them, pixel by pixel. Then each entry's own thread adds up the parts.
//
// The order of a sum depends only on the entries and their bits: pixels of a part, parts of a
// block, blocks. No two threads add to the same number, and no operation depends on the size of a
// subgroup.

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<storage, read> footprints: array<Footprint>;
@group(0) @binding(2) var<storage, read> buckets: Buckets;
@group(0) @binding(3) var<storage, read> sorted_entries: array<u32>;
@group(0) @binding(4) var<storage, read> entries: array<Entry>;
@group(0) @binding(5) var<storage, read> bucket_pixels: array<vec4f>;

struct Bucket {
    tile: u32,
    first: u32,
    len: u32,
    before: u32,
}

struct Buckets {
    count: u32,
    padding: array<u32, 3>,
    slots: array<Bucket>,
}

// Most entries of a bucket that the two phases take at a time: half a bucket, so that at least two
// threads share an entry in phase 2.
const ROWS = BUCKET / 2u;
// Length of a row in memory: odd, so that rows begin in different banks.
const ROW_STRIDE = BLOCK_PIXELS + 1u;

// Of the bucket's splats: centre x, y, root_x, root_xy; root_y, log2_opacity, log2_threshold, red;
// green, blue.
var<workgroup> splats_a: array<vec4f, BUCKET>;
var<workgroup> splats_b: array<vec4f, BUCKET>;
var<workgroup> splats_c: array<vec2f, BUCKET>;
// By thread: the blocks of its entry, and how many of the bucket's entries its pixels look at, a
// byte for each block.
var<workgroup> blocks_of: array<u32, BUCKET>;
var<workgroup> looks_at: array<vec2u, BUCKET>;
// By block: which entries it looks at. The first of the four quarters [4, BLOCKS] is the result.
var<workgroup> waiting_words: array<vec2u, BUCKET>;
var<workgroup> waiting_of_block: array<u32, BLOCKS>;
// What phase 1 stores: [rows, pixels].
var<workgroup> pairs: array<vec2f, ROWS * ROW_STRIDE>;

// Stages the bucket's splats, and finds which of them each block looks at. `counts` has a byte for
// each block: how many of the bucket's entries the block's pixel of this thread looks at. Returns
// the number of this thread's entry.
fn stage(bucket: Bucket, local: u32, counts: vec2u) -> u32 {
    var entry = 0u;
    var blocks = 0u;
    if (local < bucket.len) {
        entry = sorted_entries[bucket.first + local];
        let pair = entries[entry];
        let f = footprints[pair.splat];
        blocks = pair.blocks;
        splats_a[local] = vec4f(f.mean_px, f.root_x, f.root_xy);
        splats_b[local] = vec4f(f.root_y, f.log2_opacity, f.log2_threshold, f.red);
        splats_c[local] = vec2f(f.green, f.blue);
    }
    blocks_of[local] = blocks;
    looks_at[local] = counts;
    workgroupBarrier();
    // A thread takes a block, and a quarter of the entries and pixels.
    let block = local % BLOCKS;
    let first = local / BLOCKS * (BUCKET / 4u);
    var word = 0u;
    var most = 0u;
    for (var n = first; n < first + BUCKET / 4u; n++) {
        word |= ((blocks_of[n] >> block) & 1u) << n;
        let bytes = looks_at[n];
        most = max(most, (select(bytes.x, bytes.y, block >= 4u) >> (8u * (block & 3u))) & 0xffu);
    }
    waiting_words[local] = vec2u(word, most);
    workgroupBarrier();
    if (local < BLOCKS) {
        let a = waiting_words[local];
        let b = waiting_words[local + BLOCKS];
        let c = waiting_words[local + 2u * BLOCKS];
        let d = waiting_words[local + 3u * BLOCKS];
        let seen = max(max(a.y, b.y), max(c.y, d.y));
        waiting_of_block[local] = (a.x | b.x | c.x | d.x) & select((1u << seen) - 1u, 0xffffffffu, seen >= BUCKET);
    }
    return entry;
}

// Returns a block's byte of `counts`: `count` of the bucket's entries, at most all.
fn count_of_block(block: u32, count: u32) -> vec2u {
    let byte = min(count, BUCKET) << (8u * (block & 3u));
    return select(vec2u(byte, 0u), vec2u(0u, byte), block >= 4u);
}

// Returns which of the waiting entries are next: all, or those of the front half of the bucket.
fn next_rows(waiting: u32) -> u32 {
    return select(waiting & ((1u << ROWS) - 1u), waiting, countOneBits(waiting) <= ROWS);
}

// Returns how many pixels a thread adds up in phase 2, which is also the number of rows that have
// threads then: with few rows four threads share one, else two.
fn span_of(rows: u32) -> u32 {
    return select(BLOCK_PIXELS / 2u, BLOCK_PIXELS / 4u, countOneBits(rows) <= BLOCK_PIXELS / 4u);
}

// Returns the row of an entry.
fn row_of(rows: u32, number: u32) -> u32 {
    return countOneBits(rows & ((1u << number) - 1u));
}
