//! Tests of checkpoints.

use luxel_core::{Activation, Antialias, Cutoffs, RadianceScale, random};
use proptest::prelude::*;

use super::*;
use crate::IoErrorKind;

const LCD: ColorModel = ColorModel::Lcd { chroma_degree: 1, luminance_degree: 1, activation: Activation::Exp };

fn name() -> &'static Path {
    Path::new("step.safetensors")
}

fn splats(color_model: ColorModel, n: usize, seed: u64) -> Splats {
    let values = |array: u64, width: usize| -> Vec<f32> {
        (0..n * width).map(|i| random::standard_normal(seed ^ (array << 32), i as u64)[0]).collect()
    };
    Splats {
        color_model,
        position: values(0, 3).as_chunks().0.to_vec(),
        rotation: values(1, 4).as_chunks().0.to_vec(),
        log_scale: values(2, 3).as_chunks().0.to_vec(),
        opacity_logit: values(3, 1),
        sh: values(4, 3 * color_model.sh_coefficients()),
        raw_luminance: values(5, color_model.luminance_coefficients()),
        smoothing: Vec::new(),
        gain: Vec::new(),
    }
}

fn snapshot(color_model: ColorModel, n: usize, seed: u64) -> Snapshot {
    let mut scene_splats = splats(color_model, n, seed);
    if seed.is_multiple_of(2) {
        scene_splats.smoothing = vec![0.125; n];
    }
    let moments = Moments { first: splats(color_model, n, seed + 1), second: splats(color_model, n, seed + 2) };
    let mut stats = DensifyStats::zeros(n);
    stats.views = (0..n as u32).map(|i| i.wrapping_mul(0x9e37_79b9)).collect();
    stats.gradient = moments.first.opacity_logit.clone();
    if seed.is_multiple_of(3) {
        stats = DensifyStats::default();
    }
    let raster = RasterConfig { cutoffs: Cutoffs::PARITY, antialias: Antialias::Mip, ..RasterConfig::default() };
    let scene = Scene {
        splats: scene_splats,
        radiance_scale: RadianceScale::new(0.1).unwrap(),
        color_space: ColorSpace::AcesCg,
        raster,
        edits: Vec::new(),
        world_from_local: Similarity::IDENTITY,
        metres_per_unit: Some(0.25),
    };
    let average = seed.is_multiple_of(5).then(|| splats(color_model, n, seed + 3));
    Snapshot { scene, moments, stats, average, state_json: format!("{{\"step\":{seed},\"note\":\"\\\"\u{fffd}\n\"}}") }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn every_snapshot_is_read_back_bit_for_bit(degree in 0u8..=5, luminance in 0u8..=3, is_lcd: bool, n in 0usize..30, seed in 0u64..1 << 60) {
        let lcd = ColorModel::Lcd { chroma_degree: degree, luminance_degree: luminance, activation: Activation::Relu };
        let snapshot = snapshot(if is_lcd { lcd } else { ColorModel::Sh { degree } }, n, seed);
        let bytes = encode_checkpoint(name(), &snapshot).unwrap();
        let read = decode_checkpoint(name(), &bytes).unwrap();
        prop_assert_eq!(&read, &snapshot);
        // Equal floats of unequal bits (zeros of both signs) would show here: equal snapshots give
        // equal files.
        prop_assert_eq!(encode_checkpoint(name(), &read).unwrap(), bytes);
    }

    #[test]
    fn a_flipped_bit_anywhere_is_noticed(at: prop::sample::Index, bit in 0u32..8) {
        let mut bytes = encode_checkpoint(name(), &snapshot(LCD, 3, 1)).unwrap();
        let at = at.index(bytes.len());
        bytes[at] ^= 1 << bit;
        prop_assert!(decode_checkpoint(name(), &bytes).is_err(), "bit {} of byte {}", bit, at);
    }

    #[test]
    fn any_bytes_give_an_error(mut bytes: Vec<u8>, length in 0u64..64) {
        prop_assert!(decode_checkpoint(name(), &bytes).is_err());
        bytes.splice(0..0, length.to_le_bytes());
        prop_assert!(decode_checkpoint(name(), &bytes).is_err());
    }
}

#[test]
fn values_that_fill_several_pieces_are_read_back() {
    let snapshot = snapshot(ColorModel::Sh { degree: 1 }, 10_007, 4);
    assert_eq!(decode_checkpoint(name(), &encode_checkpoint(name(), &snapshot).unwrap()).unwrap(), snapshot);
}

#[test]
fn zeros_of_both_signs_and_moments_of_any_bits_survive() {
    let mut snapshot = snapshot(LCD, 2, 1);
    snapshot.scene.splats.position[0] = [-0.0, 0.0, 1e-42];
    snapshot.moments.second.sh[1] = f32::INFINITY;
    let read = decode_checkpoint(name(), &encode_checkpoint(name(), &snapshot).unwrap()).unwrap();
    assert_eq!(read.scene.splats.position[0].map(f32::to_bits), snapshot.scene.splats.position[0].map(f32::to_bits));
    assert_eq!(read.moments.second.sh[1], f32::INFINITY);
}

#[test]
fn other_programs_read_the_tensors() {
    let snapshot = snapshot(LCD, 5, 2);
    let bytes = encode_checkpoint(name(), &snapshot).unwrap();
    let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let sh = file.tensor("splats.sh").unwrap();
    assert_eq!((sh.shape(), sh.dtype()), ([5, 4, 3].as_slice(), Dtype::F32));
    assert_eq!(sh.data()[4..8], snapshot.scene.splats.sh[1].to_le_bytes());
    assert_eq!(file.len(), tensors::names(false).len());
}

#[test]
fn files_cut_anywhere_are_refused() {
    let bytes = encode_checkpoint(name(), &snapshot(LCD, 3, 1)).unwrap();
    for length in 0..bytes.len() {
        assert!(decode_checkpoint(name(), &bytes[..length]).is_err(), "cut at byte {length}");
    }
    let mut longer = bytes;
    longer.push(0);
    assert!(decode_checkpoint(name(), &longer).is_err());
}

/// Returns the file with its header's text changed and the header's length put right.
fn with_header(bytes: &[u8], change: impl Fn(String) -> String) -> Vec<u8> {
    let length = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let header = change(String::from_utf8(bytes[8..8 + length].to_vec()).unwrap());
    [&(header.len() as u64).to_le_bytes(), header.as_bytes(), &bytes[8 + length..]].concat()
}

#[test]
fn other_versions_and_kinds_of_file_are_told_apart() {
    let bytes = encode_checkpoint(name(), &snapshot(LCD, 3, 1)).unwrap();
    let error = |from: &str, to: &str| {
        let changed = with_header(&bytes, |header| {
            assert!(header.contains(from), "{from} is not in {header}");
            header.replace(from, to)
        });
        decode_checkpoint(name(), &changed).unwrap_err()
    };
    assert_eq!(error("\"version\":\"1\"", "\"version\":\"2\"").kind, IoErrorKind::Unsupported);
    assert!(error("luxel-checkpoint", "other").to_string().contains("\"format\" is \"other\""));
    assert!(error("\"format\":", "\"kind\":").to_string().contains("no \"format\": not a checkpoint"));
    assert!(error("[3,4,3]", "[4,3,3]").to_string().contains("tensor splats.sh: F32 [4, 3, 3], expected F32 [3, 4, 3]"));
    assert!(error("\"splats\":\"3\"", "\"splats\":\"1099511627776\"").to_string().contains("expected F32 [1099511627776, 3]"));
    assert!(error("[3,4,3]", "[1099511627776,1099511627776,3]").to_string().contains("header"));
    assert!(error("stats.views", "stats.vows").to_string().contains("stats.vows"));
    assert!(error("\"step\\\":1", "\"step\\\":2").to_string().contains("does not match its digest"));
    assert!(error("1e-1", "-1e-1").to_string().contains("a positive number"));
    // As of every other reader, settings that no engine can render with are refused.
    for (from, to) in [("{\\\"cutoffs\\\"", "{\\\"samples\\\":9,\\\"cutoffs\\\""), ("max_alpha\\\":0.99", "max_alpha\\\":1e6")] {
        assert!(error(from, to).to_string().contains("expected cut-offs of 0 to 1, antialias and 1 to 4 samples"), "{to}");
    }
}

#[test]
fn a_header_longer_than_the_file_is_refused_without_allocating() {
    assert!(decode_checkpoint(name(), &99_999_999u64.to_le_bytes()).unwrap_err().to_string().contains("truncated"));
}

#[test]
fn snapshots_that_could_not_be_read_back_are_not_written() {
    let broken: [fn(&mut Snapshot); 9] = [
        |s| s.average = Some(splats(LCD, 4, 1)),
        |s| s.scene.splats.position[1] = [f32::NAN; 3],
        |s| s.moments.first.sh.truncate(4),
        |s| s.moments.second.color_model = ColorModel::Sh { degree: 0 },
        |s| s.stats.views.truncate(1),
        |s| s.average = Some(splats(LCD, 2, 1)),
        |s| s.scene.raster.samples = 9,
        |s| s.scene.raster.cutoffs.alpha_floor = 1e6,
        |s| s.average = Some(splats(ColorModel::Sh { degree: 0 }, 3, 1)),
    ];
    for break_it in broken {
        let mut snapshot = snapshot(LCD, 3, 1);
        break_it(&mut snapshot);
        assert_eq!(encode_checkpoint(name(), &snapshot).unwrap_err().kind, IoErrorKind::Invalid);
    }
}

#[test]
fn checkpoints_are_listed_and_old_ones_are_pruned() {
    let run = tempfile::tempdir().unwrap();
    assert!(list_checkpoints(run.path()).unwrap().is_empty());
    for iteration in [7000, 500, 1_000_000_000, 30000] {
        write_checkpoint(&checkpoint_path(run.path(), iteration), &snapshot(LCD, 2, iteration)).unwrap();
    }
    assert!(checkpoint_path(run.path(), 7000).ends_with("checkpoints/step_000007000.safetensors"));
    std::fs::write(run.path().join("checkpoints/step_x.safetensors"), "not one").unwrap();
    std::fs::write(run.path().join("checkpoints/.luxel-abc.tmp"), "half").unwrap();
    let found = |run: &Path| -> Vec<u64> { list_checkpoints(run).unwrap().iter().map(|c| c.iteration).collect() };
    assert_eq!(found(run.path()), [1_000_000_000, 30000, 7000, 500]);
    prune_checkpoints(run.path(), 2).unwrap();
    assert_eq!(found(run.path()), [1_000_000_000, 30000]);
    assert!(!run.path().join("checkpoints/.luxel-abc.tmp").exists());
    assert!(run.path().join("checkpoints/step_x.safetensors").exists());
    prune_checkpoints(run.path(), 0).unwrap();
    assert_eq!(found(run.path()), [1_000_000_000]);
}

/// A disk that is full after some bytes.
struct FullDisk(usize);

impl Write for FullDisk {
    fn write(&mut self, buffer: &[u8]) -> std::io::Result<usize> {
        let taken = buffer.len().min(self.0);
        self.0 -= taken;
        if taken == 0 && !buffer.is_empty() { Err(std::io::ErrorKind::StorageFull.into()) } else { Ok(taken) }
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_full_disk_gives_an_error_at_whatever_byte_it_fills() {
    let snapshot = snapshot(LCD, 3, 1);
    let length = encode_checkpoint(name(), &snapshot).unwrap().len();
    for room in 0..length {
        assert_eq!(write(&mut &snapshot, &mut FullDisk(room)).unwrap_err().kind(), std::io::ErrorKind::StorageFull, "{room} bytes");
    }
}

#[test]
fn a_failed_write_leaves_the_older_checkpoint() {
    let run = tempfile::tempdir().unwrap();
    let path = checkpoint_path(run.path(), 10);
    let good = snapshot(LCD, 3, 1);
    write_checkpoint(&path, &good).unwrap();
    // Under way, the disk is full: the temporary file goes, the older one stays.
    let full = write_atomically(&path, |file| {
        file.write_all(b"half").unwrap();
        write(&mut &good, &mut FullDisk(40)).map_err(|e| IoError::system(&path, "write", &e))
    });
    assert_eq!(full.unwrap_err().kind, IoErrorKind::NoRoom);
    assert_eq!(std::fs::read_dir(run.path().join("checkpoints")).unwrap().count(), 1);
    // A folder that cannot be made, as its parent is a file.
    let error = write_checkpoint(&path.join("checkpoints/step_1.safetensors"), &good).unwrap_err();
    assert_eq!(error.kind, IoErrorKind::System);
    assert_eq!(read_checkpoint(&path).unwrap(), good);
    assert_eq!(read_checkpoint(run.path()).unwrap_err().kind, IoErrorKind::Invalid);
}
