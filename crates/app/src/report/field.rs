//! Metrics without a mu-law: a table of means and one of every view, and relative
//! errors by luminance.

use std::fmt::Write as _;

use luxel_metrics::{DecadeError, FLIP_PIXELS_PER_DEGREE, FieldMetrics};

use super::ReportSplit;
use super::html::escape;
use crate::text;

/// A metric that not every run has.
#[derive(Clone, Copy)]
struct OptionalMetric {
    name: &'static str,
    value: fn(&FieldMetrics) -> Option<f64>,
}

const OPTIONAL: [OptionalMetric; 3] = [
    OptionalMetric { name: "HDR-FLIP", value: |f| f.hdr_flip },
    OptionalMetric { name: "LPIPS (AlexNet)", value: |f| f.lpips_alex },
    OptionalMetric { name: "LPIPS (VGG16)", value: |f| f.lpips_vgg },
];

/// Returns the section; empty where nothing was measured.
pub(super) fn section(splits: &[ReportSplit]) -> String {
    let measured: Vec<(&ReportSplit, &FieldMetrics)> =
        splits.iter().filter_map(|split| Some((split, split.mean_field.as_ref()?))).collect();
    let Some(&(first_split, first)) = measured.first() else { return String::new() };
    let is_present = |metric: &OptionalMetric| measured.iter().any(|(_, mean)| (metric.value)(mean).is_some());
    let present: Vec<OptionalMetric> = OPTIONAL.into_iter().filter(is_present).collect();
    let head = |what: &str| {
        let optional = present.iter().fold(String::new(), |out, metric| out + "<th>" + metric.name + "</th>");
        format!("<thead><tr><th>{what}</th><th>PU21-PSNR, dB</th><th>PU21-SSIM</th><th>log-RMSE</th>{optional}</tr></thead>")
    };
    let row = |name: &str, f: &FieldMetrics| {
        let mut row =
            format!("<tr><td>{}</td><td>{:.2}</td><td>{:.4}</td><td>{:.4}</td>", escape(name), f.pu21_psnr, f.pu21_ssim, f.log_rmse);
        for metric in &present {
            row += &(metric.value)(f).map_or("<td></td>".into(), |value| format!("<td>{value:.4}</td>"));
        }
        row + "</tr>"
    };
    let mut out = format!("<section><h2>Metrics without a mu-law</h2><div class=\"scroll\"><table>{}<tbody>", head("mean of"));
    for (split, mean) in &measured {
        out += &row(&format!("{}, {}", split.name, text::plural(split.fields.len(), "view")), mean);
    }
    out += "</tbody></table></div>";
    out += &explanation(first, &present);
    out += &decades(&first_split.name, &first.relative_error_by_decade);
    for (split, _) in measured {
        let _ = write!(
            out,
            "<details><summary>{} of the {} split</summary><div class=\"scroll\"><table>{}<tbody>",
            text::plural(split.fields.len(), "view"),
            escape(&split.name),
            head("view")
        );
        for (name, field) in &split.fields {
            out += &row(name, field);
        }
        out += "</tbody></table></div></details>";
    }
    out + "</section>\n"
}

fn explanation(first: &FieldMetrics, present: &[OptionalMetric]) -> String {
    let mut out = format!(
        "<dl><dt>PU21</dt><dd>PSNR and SSIM of the images on a display with {} cd/m² where radiance equals the scene's scale, on a perceptually \
         uniform scale from 0.005 to 10000 cd/m² (Mantiuk &amp; Azimi 2021).</dd>\
         <dt>log-RMSE</dt><dd>Root mean squared error of log10 of the channels: 0.301 is a factor of two.</dd>",
        first.pu21_peak_luminance
    );
    for metric in present {
        out += &match metric.name {
            "HDR-FLIP" => format!(
                "<dt>HDR-FLIP</dt><dd>Visibility of the difference when flipping between the images, 0 to 1, at the worst exposure between the brightest pixel's \
                 and the median's, at {FLIP_PIXELS_PER_DEGREE:.0} pixels per degree (Andersson et al. 2021).</dd>"
            ),
            name => format!(
                "<dt>{name}</dt><dd>Distance of the network's features, mu-law images by protocol gtmax; with the given weights.</dd>"
            ),
        };
    }
    out + "</dl>"
}

/// Returns the relative errors of the first split.
fn decades(split: &str, errors: &[DecadeError]) -> String {
    let mut out = format!(
        "<div class=\"scroll\"><table><thead><tr><th>luminance, {} split</th><th>pixels</th><th>relative error</th><th>bias</th></tr></thead><tbody>",
        escape(split)
    );
    for error in errors {
        let _ = write!(
            out,
            "<tr><td>{}</td><td>{}</td><td>{:.2} %</td><td>{:+.2} %</td></tr>",
            text::decade(error.decade),
            text::count(usize::try_from(error.count).unwrap_or(usize::MAX)),
            100.0 * error.relative_error,
            100.0 * error.bias
        );
    }
    out + "</tbody></table></div>"
}
