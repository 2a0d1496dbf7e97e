//! Metrics of a split for people. A PSNR or SSIM never stands without its protocol (see
//! [`luxel_metrics`]).

use luxel::SplitMetrics;
use luxel_app::text;
use luxel_metrics::{FieldMetrics, ViewMetrics};

/// Returns the means over `views` views in one line.
pub(crate) fn mean_line(m: &ViewMetrics, views: usize) -> String {
    format!(
        "psnr {:.2} dB scene, {:.2} gtmax, {:.2} selfmax; ssim {:.4} scene, {:.4} gtmax; mean of {}",
        m.psnr_scene,
        m.psnr_gtmax,
        m.psnr_selfmax,
        m.ssim_scene,
        m.ssim_gtmax,
        text::plural(views, "view"),
    )
}

/// Columns of the terminal that a table may take.
const COLUMNS: usize = 80;

/// Columns of the metrics under the mu-law, which the names leave free.
const MU_LAW_COLUMNS: usize = 59;

/// The metrics of a view, or of a pair of images.
pub(crate) struct Row<'a> {
    /// Its name.
    pub(crate) name: &'a str,
    /// Metrics under the mu-law.
    pub(crate) mu_law: &'a ViewMetrics,
    /// Metrics without one.
    pub(crate) field: Option<&'a FieldMetrics>,
}

/// Returns tables of every view of a split and the mean.
pub(crate) fn table(name: &str, split: &SplitMetrics) -> String {
    let views = split.views.iter().map(|view| Row { name: &view.name, mu_law: &view.metrics, field: view.field.as_ref() });
    let mean = Row { name: "mean", mu_law: &split.mean, field: split.mean_field.as_ref() };
    tables(name, &views.chain([mean]).collect::<Vec<_>>())
}

/// Returns the rows as a table of metrics under the mu-law and one of those without, neither wider
/// than a terminal.
pub(crate) fn tables(title: &str, rows: &[Row<'_>]) -> String {
    let names: Vec<String> = rows.iter().map(|row| end_of_name(row.name, COLUMNS - MU_LAW_COLUMNS)).collect();
    let title = end_of_name(title, COLUMNS - MU_LAW_COLUMNS);
    let width = names.iter().chain([&title]).map(|name| name.chars().count()).max().unwrap_or(0);
    let mut out = format!(
        "{title:width$}  ------- psnr, dB -------  --------- ssim ---------  black\n\
         {:width$}    scene   gtmax  selfmax    scene   gtmax  selfmax  scene\n",
        ""
    );
    for (name, Row { mu_law: m, .. }) in names.iter().zip(rows) {
        out += &format!(
            "{name:width$}  {:7.2} {:7.2} {:8.2}  {:7.4} {:7.4} {:8.4} {:6.2}\n",
            m.psnr_scene, m.psnr_gtmax, m.psnr_selfmax, m.ssim_scene, m.ssim_gtmax, m.ssim_selfmax, m.psnr_black_scene
        );
    }
    let fields: Vec<(&String, &FieldMetrics)> = names.iter().zip(rows).filter_map(|(name, row)| Some((name, row.field?))).collect();
    let Some((_, last)) = fields.last() else { return out };
    let (lpips, network) = match (last.lpips_alex, last.lpips_vgg) {
        (Some(_), _) => ("   lpips", "    alex"),
        (None, Some(_)) => ("   lpips", "     vgg"),
        (None, None) => ("", ""),
    };
    let pu21 = format!("pu21, {} cd/m2", last.pu21_peak_luminance);
    out +=
        &format!("\n{title:width$}  {pu21:<18}      hdr-     log-{lpips}\n{:width$}       dB    ssim         flip     rmse{network}\n", "");
    for (name, f) in fields {
        let flip = f.hdr_flip.map_or_else(|| "-".into(), |flip| format!("{flip:.4}"));
        let lpips = f.lpips_alex.or(f.lpips_vgg).map_or_else(String::new, |distance| format!("  {distance:.4}"));
        out += &format!("{name:width$}  {:7.2}  {:.4}      {flip:>7}  {:7.4}{lpips}\n", f.pu21_psnr, f.pu21_ssim, f.log_rmse);
    }
    out
}

/// Returns a name in one line of at most `most` columns: of a longer one the end, which tells views
/// apart.
fn end_of_name(name: &str, most: usize) -> String {
    let name = text::one_line(name);
    match name.chars().count().checked_sub(most) {
        None | Some(0) => name.into_owned(),
        Some(over) => std::iter::once('…').chain(name.chars().skip(over + 1)).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_fit_into_a_terminal() {
        let (mu_law, field) = (ViewMetrics { psnr_scene: 100.0, ..ViewMetrics::default() }, FieldMetrics::default());
        let field = FieldMetrics { hdr_flip: Some(0.5), lpips_alex: Some(0.25), pu21_peak_luminance: 10_000.0, ..field };
        let names = ["images/2024-08-17 church of our lady/DSC_0001", "images/2024-08-17 church of our lady/DSC_0002", "mean"];
        let rows = names.map(|name| Row { name, mu_law: &mu_law, field: Some(&field) });
        let text = tables("test_gain_per_view", &rows);
        assert!(text.lines().all(|line| line.chars().count() <= COLUMNS), "{text}");
        for part in ["…of our lady/DSC_0001", "…of our lady/DSC_0002", "0.2500", "alex", "100.00"] {
            assert!(text.contains(part), "{part} in {text}");
        }
    }
}
