//! Metrics of a split for people. A PSNR or SSIM never stands without its protocol (see
//! [`luxel_metrics`]).

use luxel::{SplitMetrics, text};
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

/// Returns a table of every view and the mean.
pub(crate) fn table(name: &str, split: &SplitMetrics) -> String {
    let names: Vec<_> = split.views.iter().map(|view| text::one_line(&view.name)).collect();
    let width = names.iter().map(|name| name.chars().count()).max().unwrap_or(0).max(4);
    let peak = split.mean_field.as_ref().map_or(0.0, |field| field.pu21_peak_luminance);
    let distance = |field: &FieldMetrics| field.lpips_alex.or(field.lpips_vgg);
    let network = split.mean_field.as_ref().map_or("", |field| match (field.lpips_alex, field.lpips_vgg) {
        (Some(_), _) => "    alex",
        (None, Some(_)) => "     vgg",
        (None, None) => "",
    });
    let lpips = if network.is_empty() { "" } else { "   lpips" };
    let pu21 = format!("pu21, {peak} cd/m2");
    let mut out = format!(
        "{name:width$}  ------- psnr, dB --------  --------- ssim ---------  black  {pu21:<15}     hdr-     log-{lpips}\n\
         {:width$}    scene   gtmax  selfmax    scene   gtmax  selfmax  scene      dB    ssim      flip     rmse{network}\n",
        ""
    );
    let rows = names.iter().zip(&split.views).map(|(name, view)| (name.as_ref(), &view.metrics, &view.field));
    for (name, m, field) in rows.chain([("mean", &split.mean, &split.mean_field)]) {
        out += &format!(
            "{name:width$}  {:7.2} {:7.2} {:8.2}  {:7.4} {:7.4} {:8.4} {:6.2}",
            m.psnr_scene, m.psnr_gtmax, m.psnr_selfmax, m.ssim_scene, m.ssim_gtmax, m.ssim_selfmax, m.psnr_black_scene
        );
        if let Some(f) = field {
            let flip = f.hdr_flip.map_or_else(|| "-".into(), |flip| format!("{flip:.4}"));
            out += &format!(" {:7.2}  {:.4}   {flip:>7}  {:7.4}", f.pu21_psnr, f.pu21_ssim, f.log_rmse);
            out += &distance(f).map_or_else(String::new, |distance| format!("  {distance:.4}"));
        }
        out.push('\n');
    }
    out
}
