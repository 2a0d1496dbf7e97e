//! Scenes that are not stored as splats, from the command line: radiance fields and anchors are
//! trained, evaluated, rendered, resumed, and refused where splats are needed.

use crate::common::Workplace;

/// A kind of scene, and a run of it.
struct Kind {
    /// Options of the shortest run that means something.
    train: &'static [&'static str],
    /// Name of the folder and the file of its scenes.
    name: &'static str,
    /// Name of the method.
    method: &'static str,
    /// Name in errors and descriptions.
    words: &'static str,
}

const FIELD: Kind = Kind {
    train: &["train", "data", "--method", "nerf-grid", "--iterations", "30", "--eval-at", "0"],
    name: "field",
    method: "nerf-grid",
    words: "radiance field",
};

const ANCHORS: Kind = Kind {
    train: &["train", "data", "--method", "lcd-anchors", "--iterations", "30", "--eval-at", "0", "--init-points", "300"],
    name: "anchors",
    method: "lcd-anchors",
    words: "anchors",
};

impl Kind {
    fn train(&self, place: &Workplace, run: &str, more: &[&str]) {
        place.ok(&[self.train, &["-o", run], more].concat());
    }

    /// Checks the error of a run with more options.
    fn refused(&self, place: &Workplace, more: &[&str], parts: &[&str]) {
        place.error(&[self.train, &["-o", "run"], more].concat(), parts);
    }

    /// Returns the path of the scene of a run.
    fn file(&self, run: &str) -> String {
        let name = self.name;
        format!("{run}/{name}/iteration_30/{name}.safetensors")
    }

    fn scene(&self, place: &Workplace, run: &str) -> Vec<u8> {
        std::fs::read(place.path(&self.file(run))).unwrap()
    }

    /// Trains, measures again, renders and describes. Returns the metrics.
    fn check_life(&self, place: &Workplace, more: &[&str], described: &[&str]) -> serde_json::Value {
        self.train(place, "run", &[&["--threads", "2"], more].concat());
        let metrics = place.json("run/metrics.json");
        assert_eq!((&metrics["method"], &metrics["iterations"]), (&self.method.into(), &30.into()));
        assert!(metrics["splits"]["test"]["mean"]["psnr_scene"].is_f64(), "{metrics}");
        assert!(place.path("run/report.html").is_file() && place.path("run/log.jsonl").is_file());
        // Measured again, it is the same to the bit.
        let before = metrics["splits"]["test"]["mean"].clone();
        place.ok(&["eval", "run", "--threads", "1"]);
        assert_eq!(place.json("run/metrics.json")["splits"]["test"]["mean"], before);
        place.ok(&["render", "run", "-o", "renders", "--alpha", "--depth", "--samples", "2"]);
        let images = std::fs::read_dir(place.path("renders"))
            .unwrap()
            .filter(|entry| entry.as_ref().unwrap().path().extension().is_some_and(|extension| extension == "exr"));
        assert!(images.count() > 0);
        let told = place.ok(&["info", "run"]);
        assert!(told.contains(self.method) && described.iter().all(|words| told.contains(words)), "{told}");
        assert!(place.ok(&["info", &self.file("run")]).contains(self.words));
        metrics
    }

    fn check_bits(&self) {
        let place = Workplace::new();
        self.train(&place, "unbroken", &["--threads", "1"]);
        self.train(&place, "threads", &["--threads", "3"]);
        let unbroken = self.scene(&place, "unbroken");
        assert_eq!(self.scene(&place, "threads"), unbroken);
        // What an interrupted run leaves: its last checkpoint is of step 20, and nothing is newer.
        self.train(&place, "broken", &["--threads", "2", "--checkpoint-every", "10", "--keep-checkpoints", "9"]);
        let newest = place.path("broken/checkpoints/step_000000030.safetensors");
        std::fs::remove_file(&newest).unwrap();
        for folder in [self.name, "eval"] {
            std::fs::remove_dir_all(place.path("broken").join(folder)).unwrap();
        }
        let told = place.luxel(&["train", "--resume", "-o", "broken"]).output().unwrap();
        let stderr = String::from_utf8_lossy(&told.stderr).into_owned() + &String::from_utf8_lossy(&told.stdout);
        assert!(told.status.success() && stderr.contains("resuming after step 20"), "{stderr}");
        assert_eq!(self.scene(&place, "broken"), unbroken);
        // A damaged newest checkpoint is skipped.
        std::fs::write(newest, "torn").unwrap();
        std::fs::remove_dir_all(place.path("broken").join(self.name)).unwrap();
        place.ok(&["train", "--resume", "-o", "broken"]);
        assert_eq!(self.scene(&place, "broken"), unbroken);
    }

    fn check_refusals(&self) {
        let place = Workplace::new();
        self.train(&place, "run", &[]);
        let named = format!("{} ({})", self.words, self.method);
        for command in [
            &["export", "run", "-o", "scene.ply"][..],
            &["edit", "run", "-o", "edited.ply", "--gain", "2"],
            &["probe", "run", "-o", "probe.exr", "--at", "0,0,0"],
            &["lights", "run", "-o", "lights.usda"],
            &["mesh", "run", "-o", "mesh.ply"],
            &["mix", "run", "run", "-o", "mixed.ply"],
            &["render", "run", "-o", "renders", "--edit", "gain 2"],
            &["train", "data", "-o", "more", "--from", "run"],
        ] {
            place.error(command, &[&named, "no splats"]);
        }
        place.error(&["export", &self.file("run"), "-o", "scene.ply"], &[self.words, "no splats", "folder of its run"]);
    }
}

#[test]
fn a_field_is_trained_evaluated_and_rendered_like_splats() {
    let metrics = FIELD.check_life(&Workplace::new(), &[], &["grid levels"]);
    assert!(metrics["splats"] == 0 && metrics["field_parameters"].as_u64().unwrap() > 100_000, "{metrics}");
}

#[test]
fn anchors_are_trained_evaluated_and_rendered_like_splats() {
    let place = Workplace::new();
    let metrics = ANCHORS.check_life(&place, &["--max-splats", "500"], &["anchors", "lcd-c0-l0"]);
    // Decoded for each view, they have normals.
    place.ok(&["render", "run", "-o", "normals", "--normals"]);
    let splats = metrics["splats"].as_u64().unwrap();
    assert!(splats > 0 && splats <= 500 && splats.is_multiple_of(10) && metrics["field_parameters"].is_null(), "{metrics}");
}

#[test]
fn threads_and_an_interruption_change_no_bit_of_a_field() {
    FIELD.check_bits();
}

#[test]
fn threads_and_an_interruption_change_no_bit_of_anchors() {
    ANCHORS.check_bits();
}

#[test]
fn what_needs_splats_refuses_a_field_by_name() {
    FIELD.check_refusals();
    let place = Workplace::new();
    FIELD.train(&place, "run", &[]);
    place.error(&["render", "run", "-o", "renders", "--normals"], &["cannot render normals", "radiance field"]);
    place.error(&["render", "run", "-o", "renders", "--deep"], &["cannot render a deep image", "radiance field"]);
}

#[test]
fn what_needs_splats_refuses_anchors_by_name() {
    ANCHORS.check_refusals();
}

#[test]
fn options_and_data_that_are_not_a_fields_are_refused() {
    let place = Workplace::new();
    let refused = |more: &[&str], parts: &[&str]| FIELD.refused(&place, more, parts);
    refused(&["--max-splats", "10"], &["--max-splats", "--method lcd"]);
    refused(&["--ssim-weight", "0.1"], &["--ssim-weight", "--method lcd"]);
    refused(&["--refine-display", "5"], &["--refine-display", "--method lcd"]);
    refused(&["--device", "gpu"], &["radiance fields are computed on the processor", "--device cpu"]);
    refused(&["--profile"], &["--profile", "radiance field"]);
    place.error(&["train", "data", "-o", "run", "--field-loss", "linear"], &["--field-loss", "--method nerf-grid"]);
    assert!(!place.path("run").exists());
    FIELD.train(&place, "run", &["--field-loss", "linear"]);
    place.error(&["train", "--resume", "-o", "run", "--field-loss", "mulaw"], &["--field-loss"]);
    place.error(&["demo", "--method", "nerf-grid", "-o", "demo"], &["demo trains splats"]);
}

#[test]
fn a_study_has_fields_among_its_methods() {
    let place = Workplace::new();
    place.ok(&[
        "reproduce",
        "data",
        "-o",
        "study",
        "--methods",
        "nerf-grid,sh0",
        "--seeds",
        "1",
        "--iterations",
        "20",
        "--init-points",
        "50",
    ]);
    let report = std::fs::read_to_string(place.path("study/report.html")).unwrap();
    assert!(report.contains("hash grid") && report.contains("GaussHDR"));
    let tables = std::fs::read_to_string(place.path("study/tables.tex")).unwrap();
    assert!(tables.contains("nerf-grid (NeRF, hash grid)"), "{tables}");
    let plan = place.ok(&["reproduce", "data", "-o", "other", "--methods", "table1", "--seeds", "1", "--iterations", "20", "--dry-run"]);
    assert!(plan.contains("10 runs"), "{plan}");
}

#[test]
fn options_and_data_that_anchors_do_not_have_are_refused() {
    let place = Workplace::new();
    let refused = |more: &[&str], parts: &[&str]| ANCHORS.refused(&place, more, parts);
    refused(&["--sh-lr", "0.1"], &["--sh-lr", "--method lcd"]);
    refused(&["--validation-share", "0.1"], &["--validation-share", "--method lcd"]);
    refused(&["--refine-display", "5"], &["--refine-display", "--method lcd"]);
    refused(&["--antialias", "mip"], &["--antialias", "off or pixel"]);
    refused(&["--device", "gpu"], &["anchors are decoded and trained on the processor", "--device cpu"]);
    refused(&["--profile"], &["--profile", "anchors"]);
    place.error(&["train", "data", "-o", "run", "--method", "gausshdr-anchors"], &["expected a captured LDR image", "--supervision hdr"]);
    assert!(!place.path("run").exists());
    ANCHORS.train(&place, "run", &["--activation", "exp"]);
    place.error(&["train", "--resume", "-o", "run", "--activation", "softplus"], &["--activation"]);
    place.error(&["demo", "--method", "lcd-anchors", "-o", "demo"], &["demo trains splats"]);
}

#[test]
fn a_study_has_anchors_among_its_methods() {
    let place = Workplace::new();
    let study = ["reproduce", "data", "-o", "study", "--seeds", "1", "--iterations", "20", "--init-points", "50"];
    place.ok(&[&study[..], &["--methods", "lcd-anchors,sh0"]].concat());
    let tables = std::fs::read_to_string(place.path("study/tables.tex")).unwrap();
    assert!(tables.contains("lcd-anchors (LCD on anchors)"), "{tables}");
}
