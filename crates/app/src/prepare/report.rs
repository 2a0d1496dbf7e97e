//! The report of a preparation: `prepare.json` for programs, `prepare.html` for people.

use std::fmt::Write as _;
use std::path::Path;

use luxel::Result;
use luxel_capture::prepare::{LeftOut, Registration, ViewRecord};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::folders::Folders;
use super::world::WorldReport;
use crate::files::{read_text, write_json, write_text};
use crate::report::html::{document, escape};
use crate::schema;
use crate::text;

/// Name of the report in a data set's folder.
const FILE_NAME: &str = "prepare.json";
/// Units of images whose exposures are all known.
pub(super) const ABSOLUTE_UNITS: &str = "cd/m2 as far as EXIF and ISO 12232 tell it";
/// Length of a report that is read, bytes.
const MAX_BYTES: u64 = 64 << 20;

/// Returns the luminance in cd/m2 of one unit of the data set at `path`, which its preparation has
/// recorded; `None` where it is relative, or was not prepared by this program.
pub fn cd_m2_per_unit(path: &Path) -> Option<f64> {
    #[derive(Deserialize)]
    struct Units {
        units: String,
    }
    let Units { units } = read_fields(path)?;
    units.starts_with("cd/m2").then_some(1.0)
}

/// Returns the length in metres of one unit of the data set at `path`, which its preparation has
/// recorded; `None` where it is unknown, or was not prepared by this program.
pub fn metres_per_unit(path: &Path) -> Option<f64> {
    luxel_io::prepared_metres_per_unit(if path.is_dir() { path } else { path.parent()? })
}

/// Reads fields of the report of the data set at `path`.
fn read_fields<T: DeserializeOwned>(path: &Path) -> Option<T> {
    let folder = if path.is_dir() { path } else { path.parent()? };
    let text = read_text(&folder.join(FILE_NAME), MAX_BYTES).ok()?;
    serde_json::from_str(&text).ok()
}

/// The content of `prepare.json`: what was done with the photographs, and the outcome.
#[derive(Clone, Debug, Serialize)]
pub struct PrepareReport {
    /// Version of the program.
    pub luxel: &'static str,
    /// The folder of photographs.
    pub photos: String,
    /// Photographs used.
    pub photographs: usize,
    /// Colour space of the images.
    pub color_space: &'static str,
    /// Projection of the images: `pinhole` or `equirectangular`.
    pub projection: &'static str,
    /// Units of the images.
    pub units: &'static str,
    /// Description of how brackets were found.
    pub brackets: String,
    /// Response curve of developed pictures.
    pub response: Option<String>,
    /// Gains of red, green and blue, by camera.
    pub white_balance: Vec<(String, [f32; 3])>,
    /// Origin of the poses.
    pub structure_from_motion: String,
    /// Range of the set, stops: from the darkest thousandth of any view to the brightest.
    pub range_stops: f32,
    /// Advice on what to photograph again, and why.
    pub advice: Vec<String>,
    /// Notes on what is odd.
    pub notes: Vec<String>,
    /// Files that are left out, with reasons.
    pub left_out: Vec<LeftOut>,
    /// Outcome of structure from motion.
    pub registration: Option<Registration>,
    /// Coordinates, unless they are COLMAP's or there are none.
    pub world: Option<WorldReport>,
    /// Records of the views.
    pub views: Vec<ViewRecord>,
    /// Peak of resident memory, bytes.
    pub peak_memory_bytes: Option<u64>,
    /// Duration of the call that wrote the report.
    pub seconds: f64,
}

/// Writes both files.
pub(super) fn write(folders: &Folders, report: &PrepareReport) -> Result<()> {
    write_json(&folders.output.join(FILE_NAME), schema::PREPARE, report)?;
    write_text(&folders.output.join("prepare.html"), &page(report))
}

fn page(report: &PrepareReport) -> String {
    let mut body = String::from("<h2>Capture</h2><div class=\"scroll\"><table><tbody>");
    for (name, value) in facts(report) {
        let _ = write!(body, "<tr><td>{}</td><td style=\"text-align:left;white-space:normal\">{}</td></tr>", escape(&name), escape(&value));
    }
    body += "</tbody></table></div>";
    let left_out: Vec<String> = report.left_out.iter().map(|l| format!("{}: {}", l.file, l.reason)).collect();
    for (title, lines) in [("What to photograph again", &report.advice), ("Notes", &report.notes), ("Left out", &left_out)] {
        if !lines.is_empty() {
            let items: String = lines.iter().map(|line| format!("<li>{}</li>", escape(line))).collect();
            let _ = write!(body, "<h2>{title}</h2><ul>{items}</ul>");
        }
    }
    body += &table(report);
    document("Capture", &format!("{} from {}", text::plural(report.photographs, "photograph"), report.photos), &body)
}

fn facts(report: &PrepareReport) -> Vec<(String, String)> {
    let mut facts = vec![
        ("photographs".to_owned(), format!("{} in {}", text::plural(report.photographs, "file"), text::plural(report.views.len(), "view"))),
        ("brackets".to_owned(), report.brackets.clone()),
        ("images".to_owned(), format!("{}, {}, {}", report.projection, report.color_space, report.units)),
        ("range of the set".to_owned(), format!("{:.1} stops", report.range_stops)),
        ("structure from motion".to_owned(), report.structure_from_motion.clone()),
    ];
    facts.extend(report.response.iter().map(|name| ("response curve".to_owned(), name.clone())));
    for (camera, [r, g, b]) in &report.white_balance {
        facts.push((format!("white balance of {camera}"), format!("gains {r:.3}, {g:.3}, {b:.3}")));
    }
    if let Some(found) = &report.registration {
        facts.push((
            "poses".to_owned(),
            format!(
                "{} of {}; {} points, each in {:.1} views, mean error {:.2} px",
                found.views.len(),
                text::plural(report.views.len(), "view"),
                text::count(found.points),
                found.mean_track,
                found.mean_error_px
            ),
        ));
    }
    facts.extend(report.world.iter().map(|world| ("coordinates".to_owned(), world.lines().join("; "))));
    if let Some(world) = &report.world {
        let [x, y, z] = world.rotation;
        let similarity = format!("p' = {} {x:.6?} {y:.6?} {z:.6?} p + {:.6?}", world.scale, world.translation);
        facts.push(("from COLMAP's coordinates".to_owned(), similarity));
    }
    facts.extend(report.peak_memory_bytes.map(|bytes| ("peak memory".to_owned(), text::bytes(bytes))));
    facts
}

fn table(report: &PrepareReport) -> String {
    let mut out = String::from(
        "<h2>Views</h2><p class=\"note\">Exposures: stops relative to the first view's shortest. Saturated: pixels that are clipped in every exposure. \
         Black: samples that are black in every exposure. Disagreeing: samples in which exposures differ beyond noise. Range: stops between the darkest and \
         the brightest thousandth.</p><div class=\"scroll\"><table><thead><tr><th>view</th><th>exposures</th><th>saturated</th><th>black</th>\
         <th>disagreeing</th><th>shift</th><th>range</th><th>sharpness</th><th>points</th><th>error</th></tr></thead><tbody>",
    );
    let reference = report.views.first().and_then(|v| v.stops.first()).copied().unwrap_or(0.0);
    for view in &report.views {
        let stops: Vec<String> = view.stops.iter().map(|s| format!("{:+.1}", s - reference)).collect();
        let found = report.registration.as_ref().map(|r| r.views.get(&view.name));
        let (points, error) = match found {
            None => ("–".to_owned(), "–".to_owned()),
            Some(None) => ("no pose".to_owned(), "–".to_owned()),
            Some(Some(v)) => (text::count(v.points), format!("{:.2} px", v.error_px)),
        };
        let percent = |share: f64| format!("{:.2} %", 100.0 * share);
        let shift = view.offset_px.map_or("–".to_owned(), |px| format!("{px:.0} px"));
        let _ = write!(
            out,
            "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{shift}</td><td>{:.1}</td><td>{:.2}</td><td>{points}</td><td>{error}</td></tr>",
            escape(&view.name),
            stops.join(" "),
            percent(view.saturated),
            percent(view.dark),
            percent(view.disagreeing),
            view.metrics.range_stops(),
            view.metrics.sharpness,
        );
    }
    out + "</tbody></table></div>"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_unit_of_a_data_set_is_that_of_its_preparation() {
        let folder = tempfile::tempdir().unwrap();
        let unit = |content: &str| {
            std::fs::write(folder.path().join(FILE_NAME), content).unwrap();
            cd_m2_per_unit(folder.path())
        };
        assert_eq!(cd_m2_per_unit(folder.path()), None);
        let absolute = serde_json::json!({ "units": ABSOLUTE_UNITS }).to_string();
        assert_eq!((unit(&absolute), unit(r#"{"units":"relative"}"#), unit("{}"), unit("[")), (Some(1.0), None, None, None));
        unit(&absolute);
        assert_eq!(cd_m2_per_unit(&folder.path().join("transforms.json")), Some(1.0));
    }
}
