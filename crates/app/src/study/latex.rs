//! The tables for LaTeX (package booktabs), to be `\input` into a paper: the study's, and those of
//! the paper.
//!
//! In: [`Tables`]. Out: text in which names are escaped. Degenerate: missing values are dashes.

use std::fmt::Write as _;

use super::columns::{Better, Column, groups};
use super::editing::{EXPONENT, Edited};
use super::matrix::Matrix;
use super::paper::{self, PaperTable};
use super::table::{Entry, Mark, Table, printed};
use super::tables::Tables;

/// Returns text that LaTeX prints as it is. Control characters are dropped.
pub(super) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '\\' => out += "\\textbackslash{}",
            '~' => out += "\\textasciitilde{}",
            '^' => out += "\\textasciicircum{}",
            '<' => out += "\\textless{}",
            '>' => out += "\\textgreater{}",
            '|' => out += "\\textbar{}",
            // A straight one is a command to some packages, and not in every font.
            '"' => out += "''",
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => {
                out.push('\\');
                out.push(c);
            }
            c if c.is_control() => out.push(' '),
            c => out.push(c),
        }
    }
    out
}

/// Returns the tables of results, activations and the paper.
pub(super) fn document(matrix: &Matrix, tables: &Tables, missing: &[String]) -> String {
    let iterations = matrix.cells.first().map_or(0, |cell| cell.config.train.iterations);
    let protocol = format!(
        "Test views, {iterations} iterations, {} seed(s). PSNR and SSIM under the mu-law by protocol: scene (one constant per scene), gtmax (maximum of the \
         ground truth), selfmax (each image's own maximum). Best bold, second best underlined.",
        matrix.seeds.len()
    );
    let mut out = format!("% Made by luxel reproduce {}. Needs \\usepackage{{booktabs}}.\n", luxel::VERSION);
    for run in missing {
        let _ = writeln!(out, "% Missing: {}", escape(run));
    }
    out.push('\n');
    if let Some(average) = &tables.average {
        out += &table(matrix, average, &format!("Mean of all data sets. {protocol}"), "mean-of-data-sets");
    }
    for (source, results) in matrix.sources.iter().zip(&tables.results) {
        out += &table(matrix, results, &format!("Results on {}. {protocol}", source.name), &format!("results-{}", source.name));
    }
    for (source, activations) in matrix.sources.iter().zip(&tables.activations) {
        let label = format!("activation-{}", source.name);
        out += &table(matrix, activations, &format!("Activation of the luminance on {}. {protocol}", source.name), &label);
    }
    for table in &paper::RESULTS {
        out += &papers(table, "Results", &format!("paper-{}", table.dataset));
    }
    for table in &paper::ACTIVATIONS {
        out += &papers(table, "Activation of the luminance", &format!("paper-activation-{}", table.dataset));
    }
    out
}

/// Returns a table of the study. `caption` and `label` are plain text.
pub(super) fn table(matrix: &Matrix, table: &Table, caption: &str, label: &str) -> String {
    let mut out = head(caption, &format!("l{}", "r".repeat(table.columns.len())));
    let mut first_line = String::new();
    for (name, count) in groups(&table.columns) {
        let _ = match count {
            1 => write!(first_line, " & {}", escape(name)),
            _ => write!(first_line, " & \\multicolumn{{{count}}}{{c}}{{{}}}", escape(name)),
        };
    }
    let heads = table.columns.iter().fold(String::new(), |out, column| out + " & " + &escape(column.head) + arrow(column));
    let _ = writeln!(out, "{first_line} \\\\\nmethod{heads} \\\\\n\\midrule");
    for row in &table.rows {
        let model = matrix.methods[row.method];
        let _ = write!(out, "{} ({})", escape(&model.name()), escape(&matrix.description(model)));
        for (entry, column) in row.entries.iter().zip(&table.columns) {
            let _ = write!(out, " & {}", entry.as_ref().map_or_else(|| "--".into(), |entry| value(entry, column)));
        }
        out += " \\\\\n";
    }
    out + &foot(label)
}

/// Returns a table of the paper.
pub(super) fn papers(table: &PaperTable, what: &str, label: &str) -> String {
    let caption = format!("{what} as published by LCD-GS on {}: other data, one RTX 4090, not comparable number by number.", table.dataset);
    let mut out = head(&caption, "lrrrrrr");
    out += "method & min$\\downarrow$ & MB$\\downarrow$ & PSNR$\\uparrow$ & SSIM$\\uparrow$ & LPIPS$\\downarrow$ & fps$\\uparrow$ \\\\\n\\midrule\n";
    for row in table.rows {
        let paper::PaperRow { method, minutes, memory_mb, psnr, ssim, lpips, fps } = row;
        let _ = writeln!(out, "{} & {minutes} & {memory_mb} & {psnr:.2} & {ssim:.3} & {lpips:.3} & {fps} \\\\", escape(method));
    }
    out + &foot(label)
}

/// Returns the table of luminance editing; empty without edits.
pub(super) fn editing(matrix: &Matrix, edited: &[Edited]) -> String {
    if edited.is_empty() {
        return String::new();
    }
    let caption = format!(
        "Luminance to the power {EXPONENT}: errors against the unedited renders with the same map on each pixel's luminance, over the test views. Chromaticity: sum \
         of the absolute differences of the channels' shares, 0 to 2."
    );
    let mut out = head(&caption, "llrrrr");
    out += " & & \\multicolumn{3}{c}{chromaticity error} & luminance error \\\\\ndata & scene & mean & 95 \\% & by light & mean, EV \\\\\n\\midrule\n";
    for edited in edited {
        let (source, f) = (escape(&matrix.sources[edited.source].name), &edited.fidelity);
        let errors = [f.chromaticity, f.chromaticity_p95, f.chromaticity_by_light, f.luminance_stops].map(|error| format!("{error:.4}"));
        let _ = writeln!(out, "{source} & {} & {} \\\\", escape(&edited.name(matrix)), errors.join(" & "));
    }
    out + &foot("editing")
}

pub(super) fn head(caption: &str, columns: &str) -> String {
    format!("\\begin{{table}}\n\\centering\n\\caption{{{}}}\n\\begin{{tabular}}{{{columns}}}\n\\toprule\n", escape(caption))
}

pub(super) fn foot(label: &str) -> String {
    // Labels are no text: only what they may consist of is left.
    let label: String = label.chars().map(|c| if c.is_ascii_alphanumeric() || "-:".contains(c) { c } else { '-' }).collect();
    format!("\\bottomrule\n\\end{{tabular}}\n\\label{{tab:{label}}}\n\\end{{table}}\n\n")
}

fn arrow(column: &Column) -> &'static str {
    match column.better {
        Better::Higher => "$\\uparrow$",
        Better::Lower => "$\\downarrow$",
        Better::Neither => "",
    }
}

fn value(entry: &Entry, column: &Column) -> String {
    let mean = printed(entry.stat.mean, column.decimals);
    let mean = match entry.mark {
        Mark::None => mean,
        Mark::Best => format!("\\textbf{{{mean}}}"),
        Mark::Second => format!("\\underline{{{mean}}}"),
    };
    let spread = entry.stat.deviation.map(|deviation| format!(" {{\\scriptsize$\\pm${}}}", printed(deviation, column.decimals)));
    mean + &spread.unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::super::columns::by_key;
    use super::super::table::Stat;
    use super::*;

    #[test]
    fn what_latex_would_take_for_commands_is_text() {
        assert_eq!(
            escape("my_scene #2 50% {a}\\b ~^ a<b"),
            "my\\_scene \\#2 50\\% \\{a\\}\\textbackslash{}b \\textasciitilde{}\\textasciicircum{} a\\textless{}b"
        );
        assert_eq!(escape("Küche\n$&"), "Küche \\$\\&");
        assert!(foot("desk_lamp $x$").contains("\\label{tab:desk-lamp--x-}"));
    }

    #[test]
    fn marks_are_bold_and_underlined() {
        let entry = |mark| Entry { stat: Stat { mean: 31.456, deviation: Some(0.204), count: 3 }, mark };
        let psnr = by_key("psnr_scene");
        assert_eq!(value(&entry(Mark::Best), psnr), "\\textbf{31.46} {\\scriptsize$\\pm$0.20}");
        assert_eq!(value(&entry(Mark::Second), psnr), "\\underline{31.46} {\\scriptsize$\\pm$0.20}");
        let alone = Entry { stat: Stat { mean: 1234.6, deviation: None, count: 1 }, mark: Mark::None };
        assert_eq!(value(&alone, by_key("peak_memory_mb")), "1,235");
    }

    #[test]
    fn the_papers_tables_say_whose_they_are() {
        let table = papers(&paper::RESULTS[0], "Results", "paper");
        assert!(
            table.contains("as published by LCD-GS on HDR-Syn-8S")
                && table.contains("LCD-GS & 14 & 1641 & 42.69 & 0.989 & 0.004 & 227 \\\\"),
            "{table}"
        );
    }
}
