//! `luxel compare RUN RUN`: the table of two runs on the same test views.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result};
use luxel::compare::{CompareOptions, ImageMetrics, MeanMetrics};
use luxel_app::compare::{ComparedRun, RunComparison, compare_runs};
use luxel_app::{files, output, schema, text};

use crate::args::CompareArgs;
use crate::output::console::Console;
use serde_json::json;

/// Compares and prints.
pub(super) fn run(runs: [&PathBuf; 2], options: &CompareOptions, args: &CompareArgs, console: &Console) -> Result<()> {
    let _confinement = match &args.output {
        Some(folder) => {
            output::check_new_folder(folder)?;
            std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot create the folder", folder.display()))?;
            Some(luxel_io::confine(folder)?)
        }
        None => None,
    };
    let found = compare_runs(runs.map(PathBuf::as_path), options, args.output.as_deref(), console)?;
    if let Some(folder) = &args.output {
        let path = folder.join("runs.json");
        files::write_json(&path, schema::RUN_COMPARISON, &found)?;
        console.note(&format!("{}, and a picture of each of {}", path.display(), text::plural(found.views.len(), "view")));
    }
    let text = match args.json {
        true => serde_json::to_string_pretty(&schema::RUN_COMPARISON.versioned(&found)).context("cannot encode the metrics")?,
        false => table(&found).trim_end().to_owned(),
    };
    console.finish(json!({ "comparison": found }), &text)
}

/// A metric of the table.
struct Row {
    name: &'static str,
    label: &'static str,
    digits: usize,
    value: fn(&MeanMetrics) -> Option<f64>,
}

const ROWS: [Row; 12] = [
    Row { name: "psnr_scene", label: "psnr scene, dB", digits: 2, value: |m| Some(m.mu_law.psnr_scene) },
    Row { name: "psnr_gtmax", label: "psnr gtmax, dB", digits: 2, value: |m| Some(m.mu_law.psnr_gtmax) },
    Row { name: "psnr_selfmax", label: "psnr selfmax, dB", digits: 2, value: |m| Some(m.mu_law.psnr_selfmax) },
    Row { name: "ssim_scene", label: "ssim scene", digits: 4, value: |m| Some(m.mu_law.ssim_scene) },
    Row { name: "ssim_gtmax", label: "ssim gtmax", digits: 4, value: |m| Some(m.mu_law.ssim_gtmax) },
    Row { name: "ssim_selfmax", label: "ssim selfmax", digits: 4, value: |m| Some(m.mu_law.ssim_selfmax) },
    Row { name: "pu21_psnr", label: "pu21 psnr, dB", digits: 2, value: |m| Some(m.field.pu21_psnr) },
    Row { name: "pu21_ssim", label: "pu21 ssim", digits: 4, value: |m| Some(m.field.pu21_ssim) },
    Row { name: "hdr_flip", label: "hdr-flip", digits: 4, value: |m| m.field.hdr_flip },
    Row { name: "lpips_alex", label: "lpips alex", digits: 4, value: |m| m.field.lpips_alex },
    Row { name: "lpips_vgg", label: "lpips vgg", digits: 4, value: |m| m.field.lpips_vgg },
    Row { name: "log_rmse", label: "log-rmse, decades", digits: 4, value: |m| Some(m.field.log_rmse) },
];

/// Returns both runs, the means, and a row per view.
fn table(found: &RunComparison) -> String {
    let [first, second] = &found.runs;
    let mut out = format!("1  {}\n2  {}\n", described(first), described(second));
    let _ = writeln!(out, "\nmean of {}, mu = {}", text::plural(found.views.len(), "view"), found.mu);
    let _ = writeln!(out, "  {:20}{:>10}{:>10}{:>10}", "", "1", "2", "2 - 1");
    for Row { name, label, digits, value } in &ROWS {
        if let (Some(a), Some(b), Some(difference)) = (value(&first.mean), value(&second.mean), found.difference.get(name)) {
            let _ = writeln!(out, "  {label:20}{a:10.digits$}{b:10.digits$}{difference:+10.digits$}");
        }
    }
    let names: Vec<_> = found.views.iter().map(|view| text::one_line(&view.name)).collect();
    let width = names.iter().map(|name| name.chars().count()).max().unwrap_or(0).max(4);
    let _ = writeln!(out, "\n{:width$}  ----- psnr scene, dB -----  ------- ssim scene -------", "view");
    let _ = writeln!(out, "{:width$}  {:>8}{:>8}{:>10}  {:>8}{:>8}{:>10}", "", "1", "2", "2 - 1", "1", "2", "2 - 1");
    for (name, view) in names.iter().zip(&found.views) {
        let of = |image: &ImageMetrics| [image.mu_law.psnr_scene, image.mu_law.ssim_scene];
        let ([psnr_1, ssim_1], [psnr_2, ssim_2]) = (of(&view.first), of(&view.second));
        let _ = writeln!(
            out,
            "{name:width$}  {psnr_1:8.2}{psnr_2:8.2}{:+10.2}  {ssim_1:8.4}{ssim_2:8.4}{:+10.4}",
            psnr_2 - psnr_1,
            ssim_2 - ssim_1
        );
    }
    out + &format!("\n1 in protocol scene is {}\n", text::number(found.scale.into()))
}

/// Returns a run in a line: `runs/lcd: lcd, step 3,000, 40,000 splats, 58 s`.
fn described(run: &ComparedRun) -> String {
    let mut parts = vec![run.method.clone(), format!("step {}", text::count(run.iterations as usize))];
    parts.extend(run.splats.map(|splats| text::plural(splats, "splat")));
    let seconds = run.train_seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
    parts.extend(seconds.map(|seconds| format!("trained in {}", text::duration(seconds))));
    format!("{}: {}", run.path, parts.join(", "))
}
