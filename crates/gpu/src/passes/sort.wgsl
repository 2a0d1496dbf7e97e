// Pass `sort`: one digit of a stable least-significant-digit radix sort of (key, value) pairs, in
// three dispatches. It runs over visible splats by depth, then over entries by tile, so that each
// tile's entries are front to back. Twin: cpu/passes/sort.rs (which sorts the list of each tile by
// itself).
//
// A block is SORT_BLOCK pairs. `sort_count` counts how often each digit occurs in each block,
// [digits, blocks]. `sort_scan` sums these counts along the blocks, one workgroup per digit.
// `sort_scatter` moves pairs to their places. The place of a pair within its block follows from bit
// masks, with one bit per pair, which each digit's pairs set for 128 pairs at a time; a thread
// touches the masks of its own pair's digit alone, so that the work does not grow with the number
// of digits. The result does not depend on the order of threads, and no subgroup operations are
// needed.
//
// The first digit of depths leaves out the splats that are culled, whose number is not known
// before; `state.visible` is that of the others from then on.

struct Sort {
    shift: u32,
    // Number of pairs, if neither SORT_ENTRIES nor SORT_VISIBLE is set in flags.
    count: u32,
    flags: u32,
    // Bits of the digit.
    bits: u32,
}

@group(0) @binding(0) var<uniform> config: Sort;
@group(0) @binding(1) var<storage, read_write> state: State;
@group(0) @binding(2) var<storage, read> keys_in: array<u32>;
@group(0) @binding(3) var<storage, read> values_in: array<u32>;
@group(0) @binding(4) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(5) var<storage, read_write> values_out: array<u32>;
@group(0) @binding(6) var<storage, read_write> digit_counts: array<u32>;
@group(0) @binding(7) var<storage, read_write> digit_totals: array<u32>;

const MASK_WORDS = 4u;

fn has_flag(flag: u32) -> bool {
    return (config.flags & flag) != 0u;
}

var<workgroup> shared_count: u32;

// The number of pairs. One thread reads it, so that compilers know that it is the same for all.
fn pair_count(local: u32) -> u32 {
    if (local == 0u) {
        if (has_flag(SORT_ENTRIES)) {
            shared_count = state.entries;
        } else if (has_flag(SORT_VISIBLE)) {
            shared_count = state.visible;
        } else {
            shared_count = config.count;
        }
    }
    return workgroupUniformLoad(&shared_count);
}

fn blocks_of(count: u32) -> u32 {
    return (count + SORT_BLOCK - 1u) / SORT_BLOCK;
}

fn digit_count() -> u32 {
    return 1u << config.bits;
}

fn digit_of(key: u32) -> u32 {
    return (key >> config.shift) & (digit_count() - 1u);
}

// Reports whether a pair is sorted.
fn is_kept(key: u32) -> bool {
    return key != CULLED_KEY || !has_flag(SORT_COMPACT);
}

var<workgroup> histogram: array<atomic<u32>, DIGITS>;

@compute @workgroup_size(256)
fn sort_count(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let block = group_index(workgroup);
    let count = pair_count(local);
    let blocks = blocks_of(count);
    if (block >= blocks) {
        return;
    }
    let digits = digit_count();
    for (var digit = local; digit < digits; digit += 256u) {
        atomicStore(&histogram[digit], 0u);
    }
    workgroupBarrier();
    for (var n = local; n < SORT_BLOCK; n += 256u) {
        let at = block * SORT_BLOCK + n;
        if (at < count) {
            let key = keys_in[at];
            if (is_kept(key)) {
                atomicAdd(&histogram[digit_of(key)], 1u);
            }
        }
    }
    workgroupBarrier();
    for (var digit = local; digit < digits; digit += 256u) {
        digit_counts[digit * blocks + block] = atomicLoad(&histogram[digit]);
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
    if (digit >= digit_count()) {
        return;
    }
    let blocks = blocks_of(pair_count(local));
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

// The place of the next pair of each digit.
var<workgroup> next_place: array<u32, DIGITS>;
// Which of 128 pairs have a digit; 0 between the rounds.
var<workgroup> masks: array<atomic<u32>, DIGITS * MASK_WORDS>;
var<workgroup> thread_sums: array<u32, 128>;

// Leaves in `next_place` where the block's pairs of each digit begin: behind all smaller digits,
// and behind the digit's earlier blocks. Returns the number of all pairs to the last thread.
fn find_places(block: u32, blocks: u32, local: u32) -> u32 {
    let digits = digit_count();
    let per_thread = (digits + 127u) / 128u;
    let first = local * per_thread;
    let end = min(first + per_thread, digits);
    var own = 0u;
    for (var digit = first; digit < end; digit++) {
        own += digit_totals[digit];
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
    for (var digit = first; digit < end; digit++) {
        next_place[digit] = start + digit_counts[digit * blocks + block];
        start += digit_totals[digit];
    }
    return start;
}

// Moves 128 pairs, one for each thread that has one.
fn scatter(local: u32, is_pair: bool, key: u32, value: u32) {
    let digit = digit_of(key);
    let words = digit * MASK_WORDS;
    let own_word = local / 32u;
    let own_bit = 1u << (local & 31u);
    if (is_pair) {
        atomicOr(&masks[words + own_word], own_bit);
    }
    workgroupBarrier();
    var place = 0u;
    var is_last = false;
    var total = 0u;
    if (is_pair) {
        var rank = 0u;
        for (var word = 0u; word < MASK_WORDS; word++) {
            let pairs = atomicLoad(&masks[words + word]);
            let earlier = select(select(0u, own_bit - 1u, word == own_word), 0xffffffffu, word < own_word);
            rank += countOneBits(pairs & earlier);
            total += countOneBits(pairs);
        }
        place = next_place[digit] + rank;
        is_last = rank + 1u == total;
    }
    workgroupBarrier();
    if (is_pair) {
        atomicStore(&masks[words + own_word], 0u);
        // The last of a digit's pairs is one thread.
        if (is_last) {
            next_place[digit] += total;
        }
        keys_out[place] = key;
        values_out[place] = value;
    }
    workgroupBarrier();
}

@compute @workgroup_size(128)
fn sort_scatter(@builtin(workgroup_id) workgroup: vec3u, @builtin(local_invocation_index) local: u32) {
    let block = group_index(workgroup);
    let count = pair_count(local);
    let blocks = blocks_of(count);
    if (block >= blocks) {
        return;
    }
    for (var word = local; word < digit_count() * MASK_WORDS; word += 128u) {
        atomicStore(&masks[word], 0u);
    }
    let kept = find_places(block, blocks, local);
    if (has_flag(SORT_COMPACT) && block == 0u && local == 127u) {
        state.visible = kept;
    }
    workgroupBarrier();
    let end = min(count - block * SORT_BLOCK, SORT_BLOCK);
    for (var n = 0u; n < end; n += 256u) {
        // Two rounds at once, so that their loads overlap.
        let first = block * SORT_BLOCK + n + local;
        let at = vec2u(first, first + 128u);
        var key = vec2u(CULLED_KEY);
        var value = at;
        if (at.x < count) {
            key.x = keys_in[at.x];
            if (!has_flag(SORT_IDENTITY)) {
                value.x = values_in[at.x];
            }
        }
        if (at.y < count) {
            key.y = keys_in[at.y];
            if (!has_flag(SORT_IDENTITY)) {
                value.y = values_in[at.y];
            }
        }
        scatter(local, at.x < count && is_kept(key.x), key.x, value.x);
        scatter(local, at.y < count && is_kept(key.y), key.y, value.y);
    }
}
