//! The tables of the page.

use std::fmt::Write as _;

use crate::report::html::escape;

use super::columns::{Better, Column, by_key, groups};
use super::matrix::Matrix;
use super::paper::{self, PaperTable};
use super::results::CellResult;
use super::table::{Entry, Mark, Stat, Table, printed};

/// Returns a table of the study.
pub(super) fn ours(matrix: &Matrix, table: &Table) -> String {
    let mut out = head("method", &table.columns);
    for row in &table.rows {
        let model = matrix.methods[row.method];
        let _ = write!(out, "<tr><td><b>{}</b><br><small>{}</small></td>", escape(&model.name()), escape(&matrix.description(model)));
        for (entry, column) in row.entries.iter().zip(&table.columns) {
            let _ = write!(out, "<td>{}</td>", entry.as_ref().map_or_else(|| "–".into(), |entry| value(entry, column, matrix.seeds.len())));
        }
        out += "</tr>";
    }
    out + "</tbody></table></div>"
}

/// Returns the beginning of a table, up to its rows.
fn head(what: &str, columns: &[&Column]) -> String {
    let mut out = format!("<div class=\"scroll\"><table class=\"wide\"><thead><tr><th rowspan=\"2\">{what}</th>");
    for (name, count) in groups(columns) {
        let _ = write!(out, "<th class=\"group\" colspan=\"{count}\">{name}</th>");
    }
    out += "</tr><tr>";
    for column in columns {
        let _ = write!(out, "<th>{}{}</th>", column.head, arrow(column.better));
    }
    out + "</tr></thead><tbody>"
}

fn arrow(better: Better) -> &'static str {
    match better {
        Better::Higher => "&nbsp;↑",
        Better::Lower => "&nbsp;↓",
        Better::Neither => "",
    }
}

/// Returns mean, deviation, and the number of seeds where some are missing.
fn value(entry: &Entry, column: &Column, seeds: usize) -> String {
    let Entry { stat, mark } = entry;
    let mut out = marked(&printed(stat.mean, column.decimals), *mark);
    if let Some(deviation) = stat.deviation {
        let _ = write!(out, "<br><small>± {}</small>", printed(deviation, column.decimals));
    }
    if stat.count < seeds {
        let _ = write!(out, "<br><small>of {}</small>", stat.count);
    }
    out
}

/// Returns a table of the paper, best and second best marked as there.
pub(super) fn papers(table: &PaperTable) -> String {
    let mut out = format!("<div class=\"scroll\"><table class=\"theirs\"><thead><tr><th>the paper, {}</th>", table.dataset);
    for column in &PAPER_COLUMNS {
        let _ = write!(out, "<th>{}{}</th>", column.head, arrow(column.better));
    }
    out += "</tr></thead><tbody>";
    for row in table.rows {
        let _ = write!(out, "<tr><td>{}</td>", row.method);
        for column in &PAPER_COLUMNS {
            let value = (column.value)(row);
            // Speeds are integers except for those below 1.
            let decimals = if value.fract() == 0.0 { 0 } else { column.decimals };
            let _ = write!(out, "<td>{}</td>", marked(&printed(value, decimals), column.mark(table, value)));
        }
        out += "</tr>";
    }
    out + "</tbody></table></div>"
}

/// A column of the paper's tables.
struct PaperColumn {
    head: &'static str,
    decimals: usize,
    better: Better,
    value: fn(&paper::PaperRow) -> f64,
}

const PAPER_COLUMNS: [PaperColumn; 6] = [
    PaperColumn { head: "min", decimals: 0, better: Better::Lower, value: |row| row.minutes },
    PaperColumn { head: "MB", decimals: 0, better: Better::Lower, value: |row| row.memory_mb },
    PaperColumn { head: "PSNR", decimals: 2, better: Better::Higher, value: |row| row.psnr },
    PaperColumn { head: "SSIM", decimals: 3, better: Better::Higher, value: |row| row.ssim },
    PaperColumn { head: "LPIPS", decimals: 3, better: Better::Lower, value: |row| row.lpips },
    PaperColumn { head: "fps", decimals: 2, better: Better::Higher, value: |row| row.fps },
];

impl PaperColumn {
    /// Returns the mark by the number of different values in the table that are better.
    fn mark(&self, table: &PaperTable, value: f64) -> Mark {
        let is_better = |other: &f64| if self.better == Better::Higher { *other > value } else { *other < value };
        let mut better: Vec<f64> = table.rows.iter().map(self.value).filter(is_better).collect();
        better.sort_unstable_by(f64::total_cmp);
        better.dedup();
        match better.len() {
            0 => Mark::Best,
            1 => Mark::Second,
            _ => Mark::None,
        }
    }
}

fn marked(text: &str, mark: Mark) -> String {
    match mark {
        Mark::None => text.into(),
        Mark::Best => format!("<b class=\"best\">{text}</b>"),
        Mark::Second => format!("<u>{text}</u>"),
    }
}

/// Returns the gains in PSNR over the baseline, those on `data` beside the paper's: gains can be
/// compared across data. Empty without the baseline.
pub(super) fn gains(matrix: &Matrix, table: &Table, data: &str) -> String {
    let column = |key: &str| table.columns.iter().position(|column| column.key == key);
    let Some(baseline) = table.rows.iter().find(|row| matrix.methods[row.method] == paper::BASELINE) else { return String::new() };
    let protocols = ["psnr_scene", "psnr_gtmax", "psnr_selfmax"].map(column);
    let mean = |row: &super::table::Row, at: Option<usize>| Some(row.entries.get(at?)?.as_ref()?.stat.mean);
    let mut out = format!(
        "<div class=\"scroll\"><table><thead><tr><th rowspan=\"2\">PSNR over sh3, dB</th><th class=\"group\" colspan=\"3\">this study, {}</th>\
         <th class=\"group\" colspan=\"2\">the paper, other data</th></tr><tr><th>scene</th><th>gtmax</th><th>selfmax</th>",
        escape(data)
    );
    out += &paper::RESULTS.map(|table| format!("<th>{}</th>", table.dataset)).concat();
    out += "</tr></thead><tbody>";
    for row in table.rows.iter().filter(|row| matrix.methods[row.method] != paper::BASELINE) {
        let model = matrix.methods[row.method];
        let _ = write!(out, "<tr><td><b>{}</b></td>", escape(&model.name()));
        for at in protocols {
            let gain = mean(row, at).zip(mean(baseline, at)).map(|(ours, base)| ours - base);
            out += &gain_cell(gain);
        }
        for (results, activations) in paper::RESULTS.iter().zip(&paper::ACTIVATIONS) {
            let found = paper::name_in_results(model).and_then(|name| results.row(name));
            let found = found.or_else(|| activations.row(paper::name_of_activation(model)?));
            out += &gain_cell(found.zip(results.row("3DGS")).map(|(theirs, base)| theirs.psnr - base.psnr));
        }
        out += "</tr>";
    }
    out + "</tbody></table></div>"
}

fn gain_cell(gain: Option<f64>) -> String {
    gain.map_or_else(|| "<td>–</td>".into(), |gain| format!("<td>{gain:+.2}</td>").replace('-', "−"))
}

/// Returns every run, with a link to its own report.
pub(super) fn runs(matrix: &Matrix, results: &[CellResult]) -> String {
    let keys = [
        "train_minutes",
        "peak_memory_mb",
        "splats",
        "psnr_scene",
        "psnr_gtmax",
        "psnr_selfmax",
        "ssim_scene",
        "ssim_gtmax",
        "frames_per_second",
    ];
    let columns = keys.map(by_key);
    let mut out = head("run", &columns);
    for result in results {
        let name = format!("{} · {} · seed {}", matrix.sources[result.source].name, matrix.methods[result.method].name(), result.seed);
        let _ = write!(out, "<tr><td><a href=\"{}/report.html\">{}</a></td>", escape(&link(result)), escape(&name));
        for column in columns {
            let value = (column.value)(result).and_then(|value| Stat::from_values(&[value]));
            let _ = write!(out, "<td>{}</td>", value.map_or_else(|| "–".into(), |stat| printed(stat.mean, column.decimals)));
        }
        out += "</tr>";
    }
    out + "</tbody></table></div>"
}

/// Returns the folder as a relative address: everything but letters, digits and `-._~` is encoded.
fn link(result: &CellResult) -> String {
    let part = |part: std::path::Component<'_>| {
        let bytes = part.as_os_str().to_string_lossy().into_owned().into_bytes();
        bytes.iter().fold(String::new(), |mut out, &byte| {
            let plain = byte.is_ascii_alphanumeric() || b"-._~".contains(&byte);
            if plain {
                out.push(char::from(byte));
            } else {
                out += &format!("%{byte:02X}");
            }
            out
        })
    };
    result.place.components().map(part).collect::<Vec<_>>().join("/")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_marks_are_the_papers() {
        let html = papers(&paper::RESULTS[0]);
        for part in [
            "<b class=\"best\">42.69</b>",
            "<u>39.02</u>",
            "<b class=\"best\">252</b>",
            "<u>227</u>",
            "<b class=\"best\">1,641</b>",
            "<u>2,085</u>",
            "0.12",
        ] {
            assert!(html.contains(part), "{part}\n{html}");
        }
        assert_eq!(html.matches("<u>10</u>").count(), 2);
    }
}
