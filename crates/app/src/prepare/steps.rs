//! COLMAP's commands: features camera by camera, matches, poses.
//!
//! In: [`Pictures`] in a folder, and [`Pairing`]. Out: [`Step`]s, and the same as a script for
//! another machine. SIFT runs on the processor. All pictures of one camera share a lens: features
//! are extracted camera by camera into one database. Cut-outs of panoramas become rigs where the
//! version has them (3.12 and newer); their lens and place in the rig stay as they are.
//!
//! Degenerate: COLMAP's lists of pairs cannot hold names with spaces; then its own matcher of
//! sequences is used, and of panoramas every pair.

use std::ffi::OsString;
use std::path::Path;

use glam::DVec3;
use luxel::{Error, Remedy, Result};
use luxel_capture::prepare::{SetProjection, ViewRecord, sequential_pairs, spatial_pairs};
use luxel_capture::world::metres_of;

use super::colmap::{Colmap, Step};
use super::folders::Folders;
use super::options::{Features, Mapper, Matching, MotionOptions};
use super::pictures::{PictureGroup, Pictures};
use super::world::FileFacts;
use crate::files::write_text;
use crate::text::{plural, shell_word};

/// Number of views up to which every pair is matched.
const EXHAUSTIVE_VIEWS: usize = 200;
/// Number of panoramas up to which every pair of their cut-outs is matched: 36 for each pair.
const EXHAUSTIVE_PANORAMAS: usize = 40;
/// Share of views with a position from which pairs are chosen by position.
const MOST: f64 = 0.8;
/// Extent of positions below which GPS tells no neighbours, metres.
const LEAST_EXTENT_M: f64 = 20.0;

/// The views that are matched with each other.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Pairing {
    /// All with all.
    Exhaustive,
    /// Neighbours by name, as COLMAP chooses them.
    Neighbours,
    /// These, by index, and how they were chosen.
    Listed { pairs: Vec<[usize; 2]>, how: &'static str },
}

impl Pairing {
    /// Returns the choice in words for people.
    pub(super) fn words(&self) -> String {
        match self {
            Self::Exhaustive => "every pair matched".to_owned(),
            Self::Neighbours => "neighbours by name matched".to_owned(),
            Self::Listed { pairs, how } => format!("{} matched, {how}", plural(pairs.len(), "pair")),
        }
    }
}

impl Colmap {
    /// Refuses features and mappers that the installed version lacks.
    pub(super) fn check(&self, options: MotionOptions, matching: Matching, projection: SetProjection) -> Result<()> {
        // The words that the book explains.
        let lacks = |what: &str, needs: &'static str, option: &'static str, value: &'static str| {
            let remedy = Remedy::advice(needs).or(Remedy::set(option, value));
            Err(Error::new(format!("{} ({}) {what}", self.program.display(), self.version)).with_remedy(remedy))
        };
        if options.features == Features::Aliked && !self.abilities.aliked {
            return lacks("has no ALIKED features", "install COLMAP 4.0 or newer, built with ONNX", "features", "sift");
        }
        if options.mapper == Mapper::Global && !self.abilities.global_mapper {
            return lacks("has no global mapper", "install COLMAP 4.0 or newer (pip install pycolmap)", "mapper", "incremental");
        }
        if options.mapper == Mapper::Global && projection == SetProjection::Equirectangular {
            let message = "the global mapper does not hold the cut-outs of a panorama together";
            return Err(Error::new(message).with_remedy(Remedy::set("mapper", "incremental")));
        }
        if matching == Matching::Spatial && !self.abilities.pairs {
            return lacks("has no matching of listed pairs", "install COLMAP 3.12 or newer", "matching", "exhaustive");
        }
        Ok(())
    }

    /// Chooses the pairs of views to match.
    ///
    /// # Errors
    /// Pairs by position, without positions or with names that a list cannot hold.
    pub(super) fn pairing(
        &self,
        views: &[ViewRecord],
        facts: &FileFacts<'_>,
        matching: Matching,
        projection: SetProjection,
    ) -> Result<Pairing> {
        let is_panorama = projection == SetProjection::Equirectangular;
        let exhaustive_views = if is_panorama { EXHAUSTIVE_PANORAMAS } else { EXHAUSTIVE_VIEWS };
        let gps: Vec<_> = views.iter().map(|view| facts.view(&view.name).gps).collect();
        let known: Vec<_> = gps.iter().flatten().copied().collect();
        let metres = metres_of(&known);
        let extent = |axis: usize| {
            let along = || metres.iter().map(|p| p[axis]);
            along().fold(f64::NEG_INFINITY, f64::max) - along().fold(f64::INFINITY, f64::min)
        };
        let is_spread = !known.is_empty() && extent(0).max(extent(2)) >= LEAST_EXTENT_M;
        let has_positions = known.len() as f64 >= MOST * views.len() as f64 && is_spread;
        // COLMAP's lists separate names by spaces.
        let can_list = self.abilities.pairs && !views.iter().any(|view| view.name.contains(char::is_whitespace));
        let choice = match matching {
            Matching::Auto if views.len() <= exhaustive_views => Matching::Exhaustive,
            Matching::Auto if has_positions && can_list => Matching::Spatial,
            Matching::Auto => Matching::Sequential,
            other => other,
        };
        if choice == Matching::Spatial && !has_positions {
            let message = format!(
                "{} of {} views have a GPS position, expected most of them, and {LEAST_EXTENT_M:.0} m apart or more: neighbours cannot be \
                 chosen by position",
                known.len(),
                views.len()
            );
            return Err(Error::new(message).with_remedy(Remedy::set("matching", "sequential")));
        }
        if choice == Matching::Spatial && !can_list {
            let remedy = Remedy::advice("rename the photographs").or(Remedy::set("matching", "sequential"));
            return Err(Error::new("names with spaces cannot be listed for COLMAP").with_remedy(remedy));
        }
        let mut places = metres.into_iter();
        let positions: Vec<Option<DVec3>> = gps.iter().map(|gps| gps.and_then(|_| places.next())).collect();
        Ok(match choice {
            Matching::Auto | Matching::Exhaustive => Pairing::Exhaustive,
            // COLMAP's sequences are of one direction of the cut-outs.
            Matching::Sequential if !can_list && is_panorama => Pairing::Exhaustive,
            Matching::Sequential if !can_list => Pairing::Neighbours,
            Matching::Sequential => {
                Pairing::Listed { pairs: sequential_pairs(views.len()), how: "in the order of names with loops closed" }
            }
            Matching::Spatial => Pairing::Listed { pairs: spatial_pairs(&positions), how: "near each other by GPS" },
        })
    }

    /// Returns the commands, in order. Writes the lists of images by camera.
    pub(super) fn steps(&self, folders: &Folders, pictures: &Pictures, options: MotionOptions, pairing: &Pairing) -> Result<Vec<Step>> {
        let (extraction, matches) = if self.abilities.feature_options {
            ("--FeatureExtraction", "--FeatureMatching")
        } else {
            ("--SiftExtraction", "--SiftMatching")
        };
        let database = folders.work.join("database.db");
        let folder = folders.output.join("proxies");
        let mut steps = Vec::new();
        for (number, PictureGroup { model, params, names }) in pictures.groups.iter().enumerate() {
            let list = folders.work.join(format!("camera_{number}.txt"));
            write_text(&list, &(names.join("\n") + "\n"))?;
            let mut arguments = paths(
                "feature_extractor",
                &[
                    PathOption::new("--database_path", &database),
                    PathOption::new("--image_path", &folder),
                    PathOption::new("--image_list_path", &list),
                ],
            );
            let mut add = |name: &str, value: &str| arguments.extend([name.into(), value.into()]);
            add("--ImageReader.single_camera", "1");
            add("--ImageReader.camera_model", model.name());
            if let Some(params) = params {
                add("--ImageReader.camera_params", params);
            }
            add(&format!("{extraction}.use_gpu"), "0");
            if options.features == Features::Aliked {
                add("--FeatureExtraction.type", "ALIKED_N16ROT");
            }
            steps.push(Step { purpose: "features", arguments, total: names.len() });
        }
        let rigs = pictures.rigs.as_ref().filter(|_| self.abilities.rigs);
        if let Some(rigs) = rigs {
            let list = folders.work.join("rigs.json");
            write_text(&list, &format!("{rigs:#}\n"))?;
            let options = [PathOption::new("--database_path", &database), PathOption::new("--rig_config_path", &list)];
            steps.push(Step { purpose: "rigs", arguments: paths("rig_configurator", &options), total: 1 });
        }
        let arguments = match_arguments(folders, pictures, options, pairing, matches)?;
        steps.push(Step { purpose: "matches", arguments, total: pictures.count() });
        let sparse = folders.work.join("sparse");
        let mut arguments = paths(
            match options.mapper {
                Mapper::Incremental => "mapper",
                Mapper::Global => "global_mapper",
            },
            &[
                PathOption::new("--database_path", &database),
                PathOption::new("--image_path", &folder),
                PathOption::new("--output_path", &sparse),
            ],
        );
        if pictures.rigs.is_some() {
            // The lens of a cut-out is known, and so is its place in the rig.
            arguments.extend(["--Mapper.ba_refine_focal_length", "0", "--Mapper.ba_refine_extra_params", "0"].map(OsString::from));
        }
        if rigs.is_some() {
            arguments.extend(["--Mapper.ba_refine_sensor_from_rig", "0"].map(OsString::from));
        }
        let total = if rigs.is_some() { pictures.by_view.len() } else { pictures.count() };
        steps.push(Step { purpose: "poses", arguments, total });
        Ok(steps)
    }

    /// Returns the commands as a script, to be run elsewhere: paths are relative to the data set,
    /// and options are those of the release that is installed there.
    pub(super) fn script(&self, steps: &[Step], folders: &Folders) -> String {
        let program = shell_word(&self.program.to_string_lossy());
        let mut out = String::from(
            "#!/bin/sh\n# Poses of the pictures in proxies/, by COLMAP, into work/sparse.\nset -e\ncd \"$(dirname \"$0\")\"\n",
        );
        out += "# Files of an earlier run are of other pictures.\n";
        out += "rm -rf work/sparse work/database.db work/database.db-wal work/database.db-shm\nmkdir -p work/sparse\n";
        out += "# Since COLMAP 3.12 two groups of options have other names.\nextraction=SiftExtraction matching=SiftMatching\n";
        out += &format!("if {program} feature_extractor -h 2>&1 | grep -q FeatureExtraction.use_gpu; then\n");
        out += "  extraction=FeatureExtraction matching=FeatureMatching\nfi\n";
        let has_rigs = steps.iter().any(|step| step.purpose == "rigs");
        if has_rigs {
            out += "# Since COLMAP 3.12 the pictures that are cut out of a panorama are a rig.\nrigs=no\n";
            out += &format!("if {program} help 2>&1 | grep -q rig_configurator; then rigs=yes; fi\n");
        }
        for step in steps {
            let word = |argument: &OsString| {
                let path = Path::new(argument).strip_prefix(&folders.output).unwrap_or(Path::new(argument));
                match path.to_string_lossy().as_ref() {
                    "--SiftExtraction.use_gpu" => "--$extraction.use_gpu".to_owned(),
                    "--SiftMatching.use_gpu" => "--$matching.use_gpu".to_owned(),
                    other => shell_word(other),
                }
            };
            let mut words: Vec<String> = step.arguments.iter().map(word).collect();
            match step.purpose {
                "rigs" => out += &format!("if [ $rigs = yes ]; then {program} {}; fi\n", words.join(" ")),
                "poses" if has_rigs => {
                    // The last option is one of rigs.
                    let of_rigs = words.split_off(words.len().saturating_sub(2)).join(" ");
                    let words = words.join(" ");
                    out += &format!("if [ $rigs = yes ]; then {program} {words} {of_rigs}\nelse {program} {words}; fi\n");
                }
                _ => out += &format!("{program} {}\n", words.join(" ")),
            }
        }
        out
    }
}

/// Returns the command that matches features. Writes the list of pairs.
fn match_arguments(
    folders: &Folders,
    pictures: &Pictures,
    options: MotionOptions,
    pairing: &Pairing,
    group: &str,
) -> Result<Vec<OsString>> {
    let database = folders.work.join("database.db");
    let list = folders.work.join("pairs.txt");
    let mut arguments = match pairing {
        Pairing::Exhaustive => paths("exhaustive_matcher", &[PathOption::new("--database_path", &database)]),
        Pairing::Neighbours => paths("sequential_matcher", &[PathOption::new("--database_path", &database)]),
        Pairing::Listed { pairs, .. } => {
            let names = |view: usize| pictures.by_view.get(view).into_iter().flatten();
            let lines: String = pairs
                .iter()
                .flat_map(|[a, b]| names(*a).map(move |name| (name, *b)))
                .fold(String::new(), |lines, (a, b)| names(b).fold(lines, |lines, b| lines + &format!("{a} {b}\n")));
            write_text(&list, &lines)?;
            let options = [PathOption::new("--database_path", &database), PathOption::new("--match_list_path", &list)];
            let mut arguments = paths("matches_importer", &options);
            arguments.extend(["--match_type".into(), "pairs".into()]);
            arguments
        }
    };
    arguments.extend([format!("{group}.use_gpu").into(), "0".into()]);
    if options.features == Features::Aliked {
        arguments.extend(["--FeatureMatching.type".into(), "ALIKED_LIGHTGLUE".into()]);
    }
    Ok(arguments)
}

/// An option of COLMAP that has a path.
struct PathOption<'a> {
    name: &'static str,
    path: &'a Path,
}

impl<'a> PathOption<'a> {
    fn new(name: &'static str, path: &'a Path) -> Self {
        Self { name, path }
    }
}

/// Returns a command of COLMAP with options that have paths.
fn paths(command: &str, options: &[PathOption<'_>]) -> Vec<OsString> {
    let mut out = vec![OsString::from(command)];
    for option in options {
        out.extend([OsString::from(option.name), option.path.as_os_str().to_owned()]);
    }
    out
}
