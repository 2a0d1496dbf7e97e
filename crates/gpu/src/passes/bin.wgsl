// Pass `bin`: makes the pairs of splats and the tiles that they touch, splats front to back. Twin:
// cpu/passes/bin.rs.
//
// `bin_sum` counts the tiles and splats of each block of 256 visible splats in depth order.
// `bin_scan` finds the start of each block's entries, their number, and the sizes of the later
// dispatches; it halts the engine if the buffers are too small. `bin_emit` writes the entries,
// divided evenly between a block's threads, each with the blocks of the tile that the splat
// touches: those that the passes over pixels look at. `bin_ranges`, after the sort by tile, finds
// each tile's run of entries and divides it into buckets.
//
// Two kernels compute how many tiles a splat touches, and a compiler may round them differently. If
// `bin_emit` finds fewer than `project` counted, the surplus entries are given to a tile behind the
// last. That tile has buckets like any other but no pixels, so the sums of its entries are zero
// instead of old values.

struct Bucket {
    tile: u32,
    // The bucket's first entry, its number of entries (0: the slot is unused), and the number of
    // the tile's entries in front of it.
    first: u32,
    len: u32,
    before: u32,
}

struct Buckets {
    // Number of slots, used and unused; a folded dispatch may have more workgroups.
    count: u32,
    padding: array<u32, 3>,
    slots: array<Bucket>,
}

// Arguments of the dispatches whose sizes the device computes.
struct Dispatches {
    sort: vec3u,
    padding: u32,
    buckets: vec3u,
    padding_2: u32,
}

@group(0) @binding(0) var<uniform> camera: Camera;
@group(0) @binding(1) var<storage, read_write> state: State;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read_write> places: array<vec2u>;
@group(0) @binding(4) var<storage, read_write> block_sums: array<vec2u>;
@group(0) @binding(5) var<storage, read> footprints: array<Footprint>;
@group(0) @binding(6) var<storage, read_write> entry_tiles: array<u32>;
@group(0) @binding(7) var<storage, read_write> entries: array<Entry>;
@group(0) @binding(8) var<storage, read_write> dispatches: Dispatches;
@group(0) @binding(9) var<storage, read> sorted_tiles: array<u32>;
@group(0) @binding(10) var<storage, read_write> ranges: array<vec2u>;
@group(0) @binding(11) var<storage, read_write> buckets: Buckets;

// More entries than a buffer can hold; sums stop here.
const MOST_ENTRIES = 0x40000000u;

var<workgroup> pair_sums: array<vec2u, 256>;

// Inclusive sums over the workgroup's values, saturating at MOST_ENTRIES: the sum of two such
// values fits into 32 bits, the sum of hundreds does not.
fn scan_pairs(local: u32, value: vec2u) -> vec2u {
    pair_sums[local] = value;
    workgroupBarrier();
    for (var step = 1u; step < 256u; step *= 2u) {
        let before = select(vec2u(0u), pair_sums[max(local, step) - step], local >= step);
        workgroupBarrier();
        pair_sums[local] = min(pair_sums[local] + before, vec2u(MOST_ENTRIES));
        workgroupBarrier();
    }
    return pair_sums[local];
}

@compute @workgroup_size(256)
fn bin_sum(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let block = group_index(workgroup);
    let rank = block * 256u + local;
    var value = vec2u(0u);
    if (rank < state.visible) {
        let touched = places[order[rank]].y;
        value = vec2u(touched, select(0u, 1u, touched > 0u));
    }
    let inclusive = scan_pairs(local, value);
    if (local == 255u && block * 256u < camera.count) {
        block_sums[block] = inclusive;
    }
}

// Folds a number of workgroups into rows of MAX_GROUPS: see `group_index`.
fn fold(groups: u32) -> vec3u {
    return vec3u(min(groups, MAX_GROUPS), max((groups + MAX_GROUPS - 1u) / MAX_GROUPS, 1u), 1u);
}

fn slot_count(entries: u32) -> u32 {
    return select(0u, entries / BUCKET + camera.tiles.x * camera.tiles.y + 1u, entries > 0u);
}

@compute @workgroup_size(256)
fn bin_scan(@builtin(local_invocation_index) local: u32) {
    let blocks = (camera.count + 255u) / 256u;
    var carry = vec2u(0u);
    for (var start = 0u; start < blocks; start += 256u) {
        let block = start + local;
        var value = vec2u(0u);
        if (block < blocks) {
            value = block_sums[block];
        }
        let inclusive = scan_pairs(local, value);
        if (block < blocks) {
            block_sums[block] = min(carry + inclusive - value, vec2u(MOST_ENTRIES));
        }
        carry = min(carry + pair_sums[255], vec2u(MOST_ENTRIES));
        workgroupBarrier();
    }
    if (local == 0u) {
        state.needed = carry.x;
        state.visible = carry.y;
        if (carry.x > camera.entry_capacity && state.halted == HALT_NONE) {
            state.halted = HALT_OVERFLOW;
        }
        let entries = select(carry.x, 0u, state.halted != HALT_NONE);
        state.entries = entries;
        dispatches.sort = fold((entries + SORT_BLOCK - 1u) / SORT_BLOCK);
        dispatches.buckets = fold(slot_count(entries));
    }
}

var<workgroup> emit_base: u32;
var<workgroup> emit_total: u32;

@compute @workgroup_size(256)
fn bin_emit(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let block = group_index(workgroup);
    let rank = block * 256u + local;
    var touched = 0u;
    var splat = 0u;
    if (rank < state.visible) {
        splat = order[rank];
        touched = places[splat].y;
    }
    let inclusive = scan_pairs(local, vec2u(touched, 0u)).x;
    if (local == 255u) {
        emit_total = select(0u, inclusive, state.entries > 0u);
        emit_base = select(0u, block_sums[block].x, block * 256u < camera.count);
    }
    let total = workgroupUniformLoad(&emit_total);
    if (touched > 0u) {
        places[splat] = vec2u(emit_base + inclusive - touched, touched);
    }
    for (var n = local; n < total; n += 256u) {
        // The first splat whose entries reach beyond n.
        var low = 0u;
        var high = 255u;
        while (low < high) {
            let middle = (low + high) / 2u;
            if (pair_sums[middle].x > n) {
                high = middle;
            } else {
                low = middle + 1u;
            }
        }
        let owner = order[block * 256u + low];
        let f = footprints[owner];
        var left = n;
        if (low > 0u) {
            left -= pair_sums[low - 1u].x;
        }
        // If rounding gives fewer tiles here than `project` counted, the entry is given to the tile
        // behind the last.
        var tile = camera.tiles.x * camera.tiles.y;
        var blocks = 0u;
        let area = touched_area(f, camera.tiles);
        for (var row = area.y; row < area.w; row++) {
            let columns = touched_columns(f, area, row, camera.tiles);
            let width = columns.y - columns.x;
            if (left < width) {
                tile = row * camera.tiles.x + columns.x + left;
                blocks = touched_blocks(f, vec2u(columns.x + left, row));
                break;
            }
            left -= width;
        }
        entry_tiles[emit_base + n] = tile;
        entries[emit_base + n] = Entry(owner, blocks);
    }
}

// The first entry whose tile is not before `tile`.
fn lower_bound(tile: u32) -> u32 {
    var low = 0u;
    var high = state.entries;
    while (low < high) {
        let middle = (low + high) / 2u;
        if (sorted_tiles[middle] < tile) {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    return low;
}

@compute @workgroup_size(64)
fn bin_ranges(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let tile = group_index(workgroup) * 64u + local;
    let tiles = camera.tiles.x * camera.tiles.y;
    // The tile behind the last as well.
    if (tile > tiles) {
        return;
    }
    let first = lower_bound(tile);
    let end = lower_bound(tile + 1u);
    // A tile's slots begin where no slot of an earlier tile can be: a tile of n entries has at most
    // n / BUCKET + 1 of them.
    let slots = first / BUCKET + tile;
    let slots_end = end / BUCKET + tile + 1u;
    if (tile < tiles) {
        ranges[tile] = vec2u(first, end);
    } else {
        buckets.count = slots_end;
    }
    for (var slot = slots; slot < slots_end; slot++) {
        let before = (slot - slots) * BUCKET;
        let remaining = select(0u, end - first - before, before < end - first);
        buckets.slots[slot] = Bucket(tile, first + before, min(remaining, BUCKET), before);
    }
}
