//! `luxel compare`: metrics of two images, of two folders of them, or of two runs. None stands
//! without its protocol.

mod runs;

use std::fmt::Write as _;

use anyhow::{Context, Result, bail};
use luxel::compare::{CompareOptions, Comparison, ImageMetrics, compare};
use luxel_app::run::RunFolder;
use luxel_app::{schema, text};
use luxel_metrics::{DecadeError, FLIP_PIXELS_PER_DEGREE};
use serde_json::json;

use crate::args::CompareArgs;
use crate::output::console::Console;
use crate::output::metrics_table::{self, Row};

/// Compares and prints.
pub(crate) fn run(args: &CompareArgs) -> Result<()> {
    let console = Console::new(args.console.log_format, args.console.quiet);
    let (reference, test) = match (&args.reference, &args.second) {
        (Some(reference), _) => (reference, &args.first),
        (None, Some(test)) => (&args.first, test),
        (None, None) => bail!("expected two paths, reference and test, got one"),
    };
    let options = CompareOptions {
        scale: args.scale,
        peak_luminance: args.peak_luminance,
        mu: args.mu,
        flip: args.metrics.metrics.into(),
        lpips_weights: args.metrics.lpips_weights.clone(),
        mask: args.mask.clone(),
        transfer: args.transfer.map(Into::into),
        layer: args.layer.clone(),
        color_space: args.color_space.map(Into::into),
        heatmap: args.heatmap.clone(),
        overwrite: args.overwrite,
    };
    match [reference, test].map(|path| RunFolder::is_run(path)) {
        [true, true] => return runs::run([reference, test], &options, args, &console),
        [false, false] => {}
        [is_run, _] => {
            let (run, other) = if is_run { (reference, test) } else { (test, reference) };
            bail!("{} is a run and {} is none; expected two runs, or two images or folders of images", run.display(), other.display())
        }
    }
    if let Some(output) = &args.output {
        bail!("--output {} is for two runs; --heatmap writes error maps of images", output.display());
    }
    let found = compare(reference, test, &options, &console)?;
    let text = match args.json {
        true => serde_json::to_string_pretty(&schema::COMPARISON.versioned(&found)).context("cannot encode the metrics")?,
        false => table(&found).trim_end().to_owned(),
    };
    console.finish(json!({ "comparison": found }), &text)
}

/// Returns the metrics as a table.
fn table(found: &Comparison) -> String {
    let mut out = format!("reference  {}\ntest       {}\n", found.reference, found.test);
    let _ = writeln!(
        out,
        "scale      {} ({}):\n           1 in protocol scene and in the decades, {} cd/m2 for PU21",
        text::number(found.scale.into()),
        found.scale_rule,
        found.peak_luminance
    );
    match found.images.as_slice() {
        [image] if !found.are_folders => out += &one_pair(found, image),
        _ => out += &many_pairs(found),
    }
    out + &decades(&found.mean.field.relative_error_by_decade)
}

/// Returns every metric of one pair.
fn one_pair(found: &Comparison, image: &ImageMetrics) -> String {
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
        found.mu,
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
    let _ = writeln!(out, "pu21 psnr, dB         {:8.2}  scale displayed at {} cd/m2", f.pu21_psnr, f.pu21_peak_luminance);
    let _ = writeln!(out, "pu21 ssim             {:8.4}  of luminance", f.pu21_ssim);
    if let (Some(flip), Some([start, stop])) = (f.hdr_flip, image.hdr_flip_exposures_ev) {
        let _ = writeln!(
            out,
            "hdr-flip              {flip:8.4}  mean; 0 is equal, 1 the most; {FLIP_PIXELS_PER_DEGREE:.0} pixels per\n                                degree, exposures {start:.1} to {stop:.1} EV"
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

/// Returns a row per pair, and the means.
fn many_pairs(found: &Comparison) -> String {
    let rows = found.images.iter().map(|image| Row { name: &image.name, mu_law: &image.mu_law, field: Some(&image.field) });
    let mean = Row { name: "mean", mu_law: &found.mean.mu_law, field: Some(&found.mean.field) };
    format!("mu         {} of the mu-law, under which psnr and ssim are\n\n", found.mu)
        + &metrics_table::tables("", &rows.chain([mean]).collect::<Vec<_>>())
}

/// Returns relative errors, one line per decade.
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
