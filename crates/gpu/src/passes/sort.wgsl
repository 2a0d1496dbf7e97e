// Pass `sort`: one digit of a stable least-significant-digit radix sort of (key, value) pairs, in
// three dispatches. It runs over splats by depth, then over entries by tile, so that each tile's
// entries are front to back. Twin: cpu/passes/sort.rs (which sorts the list of each tile by
// itself).
//
// A block is SORT_BLOCK pairs. `sort_count` counts how often each digit occurs in each block,
// [digits, blocks]. `sort_scan` sums these counts along the blocks, one workgroup per digit.
// `sort_scatter` moves pairs to their places. The place of a pair within its block follows from bit
// masks, with one bit per pair, which each digit's pairs set for 128 pairs at a time. So the result
// does not depend on the order of threads, and no subgroup operations are needed.

struct Sort {
    shift: u32,
    // Number of pairs, if SORT_ENTRIES is not set in flags.
    count: u32,
    flags: u32,
    padding: u32,
}

@group(0) @binding(0) var<uniform> config: Sort;
@group(0) @binding(1) var<storage, read> state: State;
@group(0) @binding(2) var<storage, read> keys_in: array<u32>;
@group(0) @binding(3) var<storage, read> values_in: array<u32>;
@group(0) @binding(4) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(5) var<storage, read_write> values_out: array<u32>;
@group(0) @binding(6) var<storage, read_write> digit_counts: array<u32>;
@group(0) @binding(7) var<storage, read_write> digit_totals: array<u32>;

const MASK_WORDS = 4u;

fn pair_count() -> u32 {
    return select(config.count, state.entries, (config.flags & SORT_ENTRIES) != 0u);
}

fn block_count() -> u32 {
    return (pair_count() + SORT_BLOCK - 1u) / SORT_BLOCK;
}

fn digit_of(key: u32) -> u32 {
    return (key >> config.shift) & (DIGITS - 1u);
}

var<workgroup> histogram: array<atomic<u32>, DIGITS>;

@compute @workgroup_size(256)
fn sort_count(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let block = group_index(workgroup);
    let blocks = block_count();
    let count = pair_count();
    for (var digit = local; digit < DIGITS; digit += 256u) {
        atomicStore(&histogram[digit], 0u);
    }
    workgroupBarrier();
    for (var n = local; n < SORT_BLOCK; n += 256u) {
        let at = block * SORT_BLOCK + n;
        if (at < count) {
            atomicAdd(&histogram[digit_of(keys_in[at])], 1u);
        }
    }
    workgroupBarrier();
    if (block < blocks) {
        for (var digit = local; digit < DIGITS; digit += 256u) {
            digit_counts[digit * blocks + block] = atomicLoad(&histogram[digit]);
        }
    }
}

var<workgroup> sums: array<u32, 256>;

// Inclusive sums over the workgroup's values.
fn scan_256(local: u32, value: u32) -> u32 {
    sums[local] = value;
    workgroupBarrier();
    for (var step = 1u; step < 256u; step *= 2u) {
        let before = select(0u, sums[max(local, step) - step], local >= step);
        workgroupBarrier();
        sums[local] += before;
        workgroupBarrier();
    }
    return sums[local];
}

@compute @workgroup_size(256)
fn sort_scan(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let digit = workgroup.x;
    let blocks = block_count();
    var carry = 0u;
    for (var start = 0u; start < blocks; start += 256u) {
        let block = start + local;
        let at = digit * blocks + block;
        var value = 0u;
        if (block < blocks) {
            value = digit_counts[at];
        }
        let inclusive = scan_256(local, value);
        if (block < blocks) {
            digit_counts[at] = carry + inclusive - value;
        }
        carry += sums[255];
        workgroupBarrier();
    }
    if (local == 0u) {
        digit_totals[digit] = carry;
    }
}

var<workgroup> next_place: array<u32, DIGITS>;
var<workgroup> masks: array<atomic<u32>, DIGITS * MASK_WORDS>;
var<workgroup> thread_sums: array<u32, 128>;

@compute @workgroup_size(128)
fn sort_scatter(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let block = group_index(workgroup);
    let blocks = block_count();
    if (block >= blocks) {
        return;
    }
    let count = pair_count();
    // Start of each digit's pairs of this block: all smaller digits, then the digit's earlier
    // blocks.
    const PER_THREAD = DIGITS / 128u;
    var own = 0u;
    for (var k = 0u; k < PER_THREAD; k++) {
        own += digit_totals[local * PER_THREAD + k];
    }
    thread_sums[local] = own;
    workgroupBarrier();
    for (var step = 1u; step < 128u; step *= 2u) {
        let before = select(0u, thread_sums[max(local, step) - step], local >= step);
        workgroupBarrier();
        thread_sums[local] += before;
        workgroupBarrier();
    }
    var start = thread_sums[local] - own;
    for (var k = 0u; k < PER_THREAD; k++) {
        let digit = local * PER_THREAD + k;
        next_place[digit] = start + digit_counts[digit * blocks + block];
        start += digit_totals[digit];
    }
    for (var n = 0u; n < SORT_BLOCK; n += 128u) {
        for (var word = local; word < DIGITS * MASK_WORDS; word += 128u) {
            atomicStore(&masks[word], 0u);
        }
        workgroupBarrier();
        let at = block * SORT_BLOCK + n + local;
        let own_word = local / 32u;
        var key = 0u;
        var digit = 0u;
        if (at < count) {
            key = keys_in[at];
            digit = digit_of(key);
            atomicOr(&masks[digit * MASK_WORDS + own_word], 1u << (local & 31u));
        }
        workgroupBarrier();
        if (at < count) {
            var rank = 0u;
            for (var word = 0u; word < own_word; word++) {
                rank += countOneBits(atomicLoad(&masks[digit * MASK_WORDS + word]));
            }
            rank += countOneBits(atomicLoad(&masks[digit * MASK_WORDS + own_word]) & ((1u << (local & 31u)) - 1u));
            let place = next_place[digit] + rank;
            keys_out[place] = key;
            var value = at;
            if ((config.flags & SORT_IDENTITY) == 0u) {
                value = values_in[at];
            }
            values_out[place] = value;
        }
        workgroupBarrier();
        for (var k = 0u; k < PER_THREAD; k++) {
            let own_digit = local * PER_THREAD + k;
            for (var word = 0u; word < MASK_WORDS; word++) {
                next_place[own_digit] += countOneBits(atomicLoad(&masks[own_digit * MASK_WORDS + word]));
            }
        }
        workgroupBarrier();
    }
}
