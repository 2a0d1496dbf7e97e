//! The metrics of a cell by name: one list for tables, CSV and LaTeX.

use super::results::CellResult;

/// The direction in which a metric improves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Better {
    Lower,
    Higher,
    /// A fact, neither good nor bad.
    Neither,
}

/// The outputs that have a column besides the CSV.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Placement {
    /// In every table.
    Always,
    /// In tables that have a value of it.
    IfThere,
    /// In the CSV only.
    InCsv,
}

/// A metric, or a fact about a run.
#[derive(Clone, Copy)]
pub(super) struct Column {
    /// Name in the CSV, with its unit.
    pub(super) key: &'static str,
    /// Heading of the columns that belong together.
    pub(super) group: &'static str,
    /// Heading of this one.
    pub(super) head: &'static str,
    /// Decimals in tables.
    pub(super) decimals: usize,
    pub(super) better: Better,
    pub(super) placement: Placement,
    pub(super) value: fn(&CellResult) -> Option<f64>,
}

const fn column(
    key: &'static str,
    [group, head]: [&'static str; 2],
    decimals: usize,
    better: Better,
    value: fn(&CellResult) -> Option<f64>,
) -> Column {
    Column { key, group, head, decimals, better, placement: Placement::Always, value }
}

impl Column {
    const fn placed(self, placement: Placement) -> Self {
        Self { placement, ..self }
    }
}

const TEST_PSNR: &str = "PSNR, dB";
const TEST_SSIM: &str = "SSIM";
const BYTES_PER_MB: f64 = 1e6;

use Better::{Higher, Lower, Neither};

/// Every column, in the order of the tables.
pub(super) const COLUMNS: [Column; 19] = [
    column("train_minutes", ["training", "min"], 2, Lower, |r| Some(r.metrics.train_seconds / 60.0)),
    column("peak_memory_mb", ["training", "MB"], 0, Lower, |r| r.peak_bytes.map(|bytes| bytes as f64 / BYTES_PER_MB)),
    column("splats", ["", "splats"], 0, Neither, |r| r.metrics.field_parameters.is_none().then_some(r.metrics.splats as f64)),
    column("psnr_scene", [TEST_PSNR, "scene"], 2, Higher, |r| Some(r.test()?.psnr_scene)),
    column("psnr_gtmax", [TEST_PSNR, "gtmax"], 2, Higher, |r| Some(r.test()?.psnr_gtmax)),
    column("psnr_selfmax", [TEST_PSNR, "selfmax"], 2, Higher, |r| Some(r.test()?.psnr_selfmax)),
    column("ssim_scene", [TEST_SSIM, "scene"], 4, Higher, |r| Some(r.test()?.ssim_scene)),
    column("ssim_gtmax", [TEST_SSIM, "gtmax"], 4, Higher, |r| Some(r.test()?.ssim_gtmax)),
    column("ssim_selfmax", [TEST_SSIM, "selfmax"], 4, Higher, |r| Some(r.test()?.ssim_selfmax)).placed(Placement::InCsv),
    column("pu21_psnr", ["PU21", "PSNR, dB"], 2, Higher, |r| Some(r.field()?.pu21_psnr)),
    column("pu21_ssim", ["PU21", "SSIM"], 4, Higher, |r| Some(r.field()?.pu21_ssim)).placed(Placement::InCsv),
    column("log_rmse", ["log-", "RMSE"], 4, Lower, |r| Some(r.field()?.log_rmse)).placed(Placement::InCsv),
    column("hdr_flip", ["HDR-", "FLIP"], 4, Lower, |r| r.measured.as_ref()?.hdr_flip).placed(Placement::IfThere),
    column("lpips_alex", ["LPIPS", "AlexNet"], 4, Lower, |r| lpips(r, "alex")).placed(Placement::IfThere),
    column("lpips_vgg", ["LPIPS", "VGG16"], 4, Lower, |r| lpips(r, "vgg")).placed(Placement::IfThere),
    column("frames_per_second", ["", "fps"], 1, Higher, |r| r.measured.as_ref()?.frames_per_second),
    column("train_psnr_scene", ["train views", "PSNR scene"], 2, Neither, |r| Some(r.train()?.psnr_scene)),
    column("train_psnr_gtmax", ["train views", "PSNR gtmax"], 2, Neither, |r| Some(r.train()?.psnr_gtmax)).placed(Placement::InCsv),
    column("black_psnr_scene", ["black image", "PSNR scene"], 2, Neither, |r| Some(r.test()?.psnr_black_scene)).placed(Placement::InCsv),
];

fn lpips(result: &CellResult, network: &str) -> Option<f64> {
    let lpips = result.measured.as_ref()?.lpips.as_ref()?;
    (lpips.network == network).then_some(lpips.distance)
}

/// Returns the column of a key; the first if there is none.
pub(super) fn by_key(key: &str) -> &'static Column {
    COLUMNS.iter().find(|column| column.key == key).unwrap_or(&COLUMNS[0])
}

/// Returns the groups of neighbouring columns with one heading: the heading and their number.
pub(super) fn groups(columns: &[&Column]) -> Vec<(&'static str, usize)> {
    let mut groups: Vec<(&'static str, usize)> = Vec::new();
    for column in columns {
        match groups.last_mut() {
            Some((name, count)) if *name == column.group && !name.is_empty() => *count += 1,
            _ => groups.push((column.group, 1)),
        }
    }
    groups
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn keys_are_unique() {
        let keys: BTreeSet<&str> = COLUMNS.iter().map(|column| column.key).collect();
        assert_eq!(keys.len(), COLUMNS.len());
    }
}
