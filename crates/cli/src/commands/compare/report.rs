//! The figures for people and for programs. None stands without its protocol.

use std::fmt::Write as _;

use anyhow::{Context, Result};
use luxel::text;
use luxel_metrics::{DecadeError, FLIP_PIXELS_PER_DEGREE, FieldMetrics, ViewMetrics};
use serde::Serialize;

use super::measure::{Compared, Settings};
use super::pairs::{Pairs, Sources};

/// The result of the command; as JSON, its schema.
#[derive(Debug, Serialize)]
pub(super) struct Comparison {
    reference: String,
    test: String,
    /// Radiance of 1 in protocol `scene`, the decades, and of the peak luminance.
    scale: f32,
    scale_rule: &'static str,
    /// cd/m2.
    peak_luminance: f32,
    mu: f32,
    mean: Means,
    images: Vec<Compared>,
    /// Paths without a partner.
    missing_test: Vec<String>,
    missing_reference: Vec<String>,
    #[serde(skip)]
    are_folders: bool,
}

#[derive(Debug, Serialize)]
struct Means {
    #[serde(flatten)]
    mu_law: ViewMetrics,
    #[serde(flatten)]
    field: FieldMetrics,
}

impl Comparison {
    pub(super) fn new(sources: &Sources, settings: &Settings, pairs: Pairs, images: Vec<Compared>) -> Self {
        let mu_law: Vec<ViewMetrics> = images.iter().map(|image| image.mu_law).collect();
        let field: Vec<FieldMetrics> = images.iter().map(|image| image.field.clone()).collect();
        let paths = |paths: Vec<std::path::PathBuf>| paths.iter().map(|path| path.display().to_string()).collect();
        Self {
            reference: sources.reference.display().to_string(),
            test: sources.test.display().to_string(),
            scale: settings.scale,
            scale_rule: settings.scale_rule,
            peak_luminance: settings.peak_luminance,
            mu: settings.mu,
            mean: Means { mu_law: ViewMetrics::mean(&mu_law).unwrap_or_default(), field: FieldMetrics::mean(&field).unwrap_or_default() },
            images,
            are_folders: pairs.are_folders,
            missing_test: paths(pairs.only_reference),
            missing_reference: paths(pairs.only_test),
        }
    }

    pub(super) fn json(&self) -> Result<String> {
        serde_json::to_string_pretty(self).context("cannot encode the figures")
    }

    pub(super) fn text(&self) -> String {
        let mut out = format!("reference  {}\ntest       {}\n", self.reference, self.test);
        let _ = writeln!(
            out,
            "scale      {} ({}): 1 in protocol scene and in the decades, {} cd/m2 for PU21",
            text::number(self.scale.into()),
            self.scale_rule,
            self.peak_luminance
        );
        match self.images.as_slice() {
            [image] if !self.are_folders => out += &self.one(image),
            _ => out += &self.many(),
        }
        out + &decades(&self.mean.field.relative_error_by_decade)
    }

    /// Every figure of one pair.
    fn one(&self, image: &Compared) -> String {
        let mut out = format!("size       {}x{}, {}", image.width, image.height, image.color_space.name());
        if image.masked_pixels > 0 {
            let _ = write!(out, ", {} left out", text::plural(image.masked_pixels, "pixel"));
        }
        let (m, f) = (&image.mu_law, &image.field);
        let _ = write!(
            out,
            "\n\nmu-law, mu = {}        scene     gtmax   selfmax\n  psnr, dB            {:8.2}  {:8.2}  {:8.2}\n  \
             ssim                {:8.4}  {:8.4}  {:8.4}\n  l1                  {:8.5}\n  \
             black image, dB     {:8.2}  {:8.2}\n\n",
            self.mu,
            m.psnr_scene,
            m.psnr_gtmax,
            m.psnr_selfmax,
            m.ssim_scene,
            m.ssim_gtmax,
            m.ssim_selfmax,
            m.l1_scene,
            m.psnr_black_scene,
            m.psnr_black_gtmax,
        );
        let _ = writeln!(out, "pu21 psnr, dB         {:8.2}  scale shown at {} cd/m2", f.pu21_psnr, f.pu21_peak_luminance);
        let _ = writeln!(out, "pu21 ssim             {:8.4}  of luminance", f.pu21_ssim);
        if let (Some(flip), Some([start, stop])) = (f.hdr_flip, image.hdr_flip_exposures_ev) {
            let _ = writeln!(
                out,
                "hdr-flip              {flip:8.4}  mean; 0 is equal, 1 the most; {FLIP_PIXELS_PER_DEGREE:.0} pixels per degree, exposures {start:.1} to {stop:.1} EV"
            );
        }
        for (name, distance) in [("AlexNet", f.lpips_alex), ("VGG16", f.lpips_vgg)] {
            if let Some(distance) = distance {
                let _ = writeln!(out, "lpips                 {distance:8.4}  {name}, mu-law images by gtmax as [-1, 1]");
            }
        }
        let _ = writeln!(out, "log-rmse, decades     {:8.4}  of log10 of the channels", f.log_rmse);
        out
    }

    /// A row per pair, and the means.
    fn many(&self) -> String {
        let width = self.images.iter().map(|image| image.name.chars().count()).max().unwrap_or(0).max(4);
        let (lpips, network) = match (self.mean.field.lpips_alex, self.mean.field.lpips_vgg) {
            (Some(_), _) => ("  lpips,", "    alex"),
            (None, Some(_)) => ("  lpips,", "     vgg"),
            (None, None) => ("", ""),
        };
        let mut out = format!(
            "\n{:width$}  -- psnr, dB, mu = {:<6} --  ------- ssim, mu-law ------  ----- pu21 ----     hdr-      log-{lpips}\n\
             {:width$}    scene   gtmax  selfmax     scene   gtmax  selfmax      dB    ssim     flip      rmse{network}\n",
            "", self.mu, ""
        );
        let rows = self.images.iter().map(|image| (image.name.as_str(), &image.mu_law, &image.field));
        for (name, m, f) in rows.chain([("mean", &self.mean.mu_law, &self.mean.field)]) {
            let flip = f.hdr_flip.map_or_else(|| "-".into(), |flip| format!("{flip:.4}"));
            let lpips = f.lpips_alex.or(f.lpips_vgg).map_or_else(String::new, |distance| format!("  {distance:.4}"));
            let _ = writeln!(
                out,
                "{name:width$}  {:7.2} {:7.2}  {:7.2}   {:7.4} {:7.4}  {:7.4} {:7.2} {:7.4}  {flip:>7} {:9.4}{lpips}",
                m.psnr_scene,
                m.psnr_gtmax,
                m.psnr_selfmax,
                m.ssim_scene,
                m.ssim_gtmax,
                m.ssim_selfmax,
                f.pu21_psnr,
                f.pu21_ssim,
                f.log_rmse
            );
        }
        out
    }
}

/// Relative errors, one line a decade.
fn decades(errors: &[DecadeError]) -> String {
    let mut out = String::from("\nluminance of reference / scale    pixels  relative error    bias\n");
    for error in errors {
        let _ = writeln!(
            out,
            "  {:24} {:>14}  {:>13.2}% {:>+6.2}%",
            text::decade(error.decade),
            text::count(usize::try_from(error.count).unwrap_or(usize::MAX)),
            100.0 * error.relative_error,
            100.0 * error.bias
        );
    }
    out
}
