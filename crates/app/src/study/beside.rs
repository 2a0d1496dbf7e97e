//! The rows of the paper's tables, in its order, with the results of this study beside its own.
//!
//! In: a table of the study and one of the paper. Out: a row per method of the paper, with a dash
//! where the study has none. Degenerate: a study without any of the paper's methods has no table.

use std::fmt::Write as _;

use super::columns::by_key;
use super::latex;
use super::matrix::Matrix;
use super::paper::{self, PaperRow, PaperTable};
use super::table::{Table, printed};
use super::tables::Tables;
use crate::report::html::escape;

/// Columns of the study, by key, with their heads.
const OURS: [(&str, &str); 7] = [
    ("train_minutes", "min"),
    ("peak_memory_mb", "MB"),
    ("psnr_scene", "PSNR scene"),
    ("psnr_gtmax", "PSNR gtmax"),
    ("psnr_selfmax", "PSNR selfmax"),
    ("ssim_scene", "SSIM scene"),
    ("frames_per_second", "fps"),
];

/// A column of the paper: its head, decimals, and number.
type TheirColumn = (&'static str, usize, fn(&PaperRow) -> f64);

/// Columns of the paper.
const THEIRS: [TheirColumn; 6] = [
    ("min", 0, |row| row.minutes),
    ("MB", 0, |row| row.memory_mb),
    ("PSNR", 2, |row| row.psnr),
    ("SSIM", 3, |row| row.ssim),
    ("LPIPS", 3, |row| row.lpips),
    ("fps", 2, |row| row.fps),
];

/// A table of a study, and the name of its data.
#[derive(Clone, Copy)]
pub(super) struct OfStudy<'a> {
    pub(super) table: &'a Table,
    pub(super) data: &'a str,
}

/// A row: the paper's method, what stands for it here, and both results as text; `None` where there
/// is no result.
struct Row {
    method: &'static str,
    here: Option<String>,
    ours: Vec<Option<String>>,
    theirs: Vec<String>,
}

/// Returns the rows; none if the study has none of the paper's methods.
fn rows(matrix: &Matrix, table: &Table, papers: &PaperTable) -> Vec<Row> {
    let row = |theirs: &PaperRow| {
        let method = PaperTable::method(theirs.method);
        let of_study = table.rows.iter().find(|row| method == Some(matrix.methods[row.method]));
        let ours = OURS.map(|(key, _)| {
            let at = table.columns.iter().position(|column| column.key == key)?;
            let entry = of_study?.entries.get(at)?.as_ref()?;
            Some(printed(entry.stat.mean, by_key(key).decimals))
        });
        Row {
            method: theirs.method,
            here: of_study.and(method).map(|method| format!("{} ({})", method.name(), matrix.description(method))),
            ours: ours.to_vec(),
            theirs: THEIRS.map(|(_, decimals, value)| format!("{:.decimals$}", value(theirs))).to_vec(),
        }
    };
    let rows: Vec<Row> = papers.rows.iter().map(row).collect();
    if rows.iter().any(|row| row.here.is_some()) { rows } else { Vec::new() }
}

/// Returns the table as HTML; `data` names the study's data.
pub(super) fn html(matrix: &Matrix, table: &Table, papers: &PaperTable, data: &str) -> String {
    let rows = rows(matrix, table, papers);
    if rows.is_empty() {
        return String::new();
    }
    let heads = |heads: &mut dyn Iterator<Item = &str>| heads.map(|head| format!("<th>{head}</th>")).collect::<String>();
    let mut out = format!(
        "<div class=\"scroll\"><table><thead><tr><th rowspan=\"2\">the paper's method</th><th rowspan=\"2\">here</th>\
         <th class=\"group\" colspan=\"{}\">this study, {}</th><th class=\"group\" colspan=\"{}\">the paper, {}</th></tr><tr>{}{}</tr></thead><tbody>",
        OURS.len(),
        escape(data),
        THEIRS.len(),
        papers.dataset,
        heads(&mut OURS.iter().map(|(_, head)| *head)),
        heads(&mut THEIRS.iter().map(|(head, ..)| *head)),
    );
    for Row { method, here, ours, theirs } in rows {
        let _ = write!(out, "<tr><td><b>{method}</b></td><td>{}</td>", here.map_or_else(|| "–".into(), |here| escape(&here)));
        for value in ours {
            let _ = write!(out, "<td>{}</td>", value.unwrap_or_else(|| "–".into()));
        }
        for value in theirs {
            let _ = write!(out, "<td>{value}</td>");
        }
        out += "</tr>";
    }
    out + "</tbody></table></div>"
}

/// Returns the table of a study that is set beside the paper's, and the name of its data: the mean
/// of the data sets, or the only one.
pub(super) fn of_study<'a>(matrix: &'a Matrix, tables: &'a Tables) -> Option<OfStudy<'a>> {
    match (&tables.average, matrix.sources.first(), tables.results.first()) {
        (Some(table), ..) if table.has_values() => Some(OfStudy { table, data: "the mean of the data sets" }),
        (_, Some(source), Some(table)) => Some(OfStudy { table, data: &source.name }),
        _ => None,
    }
}

/// Returns the tables for LaTeX.
pub(super) fn latex(matrix: &Matrix, tables: &Tables) -> String {
    let Some(OfStudy { table, data }) = of_study(matrix, tables) else { return String::new() };
    paper::RESULTS.iter().map(|papers| latex_table(matrix, table, papers, data)).collect()
}

fn latex_table(matrix: &Matrix, table: &Table, papers: &PaperTable, data: &str) -> String {
    let rows = rows(matrix, table, papers);
    if rows.is_empty() {
        return String::new();
    }
    let caption = format!(
        "The paper's table on {} with this study on {data} beside it: other data and another machine, not comparable number by number.",
        papers.dataset
    );
    let mut out = latex::head(&caption, &format!("ll{}", "r".repeat(OURS.len() + THEIRS.len())));
    let _ =
        writeln!(out, " & & \\multicolumn{{{}}}{{c}}{{this study}} & \\multicolumn{{{}}}{{c}}{{the paper}} \\\\", OURS.len(), THEIRS.len());
    let heads = OURS.iter().map(|(_, head)| *head).chain(THEIRS.iter().map(|(head, ..)| *head));
    let _ = writeln!(out, "method & here{} \\\\\n\\midrule", heads.fold(String::new(), |out, head| out + " & " + head));
    for Row { method, here, ours, theirs } in rows {
        let here = here.map_or_else(|| "--".into(), |here| latex::escape(&here));
        let values = ours.into_iter().map(|value| value.unwrap_or_else(|| "--".into())).chain(theirs);
        let _ = writeln!(out, "{} & {here}{} \\\\", latex::escape(method), values.fold(String::new(), |out, value| out + " & " + &value));
    }
    out + &latex::foot(&format!("beside-{}", papers.dataset))
}
