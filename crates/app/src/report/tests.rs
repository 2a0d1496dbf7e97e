use luxel_core::RadianceScale;
use luxel_metrics::DecadeError;

use super::*;

/// A room with a lamp: a gradient in the dark, a bright disc, and a render that is off by `error`.
fn view(name: &str, width: usize, height: usize, error: f32) -> ReportView {
    let target = Image {
        width,
        height,
        pixels: (0..width * height)
            .map(|i| {
                let (x, y) = ((i % width) as f32 / width as f32, (i / width) as f32 / height as f32);
                let lamp = if (x - 0.7).hypot(y - 0.3) < 0.08 { 120.0 } else { 0.0 };
                let wall = 0.002 + 0.5 * (-6.0 * (x - 0.7).hypot(y - 0.3)).exp();
                [wall + lamp, 0.8 * wall + 0.9 * lamp, 0.5 * wall + 0.6 * lamp]
            })
            .collect(),
    };
    let mut prediction = target.clone();
    for (i, pixel) in prediction.pixels.iter_mut().enumerate() {
        *pixel = pixel.map(|v| v * (1.0 + error * (i as f32 * 0.37).sin()));
    }
    let metrics = luxel_metrics::view_metrics(&prediction, &target, None, 5000.0).unwrap();
    ReportView { name: name.into(), prediction, target, mask: None, metrics }
}

fn input(views: Vec<ReportView>) -> ReportInput {
    let figures: Vec<_> = views.iter().map(|v| (v.name.clone(), v.metrics)).collect();
    let mean = ViewMetrics::mean(&views.iter().map(|v| v.metrics).collect::<Vec<_>>());
    let mut profile = LuminanceProfile::default();
    for view in &views {
        profile.merge(&LuminanceProfile::measure(&view.prediction, &view.target, None, ColorSpace::LinearRec709).unwrap());
    }
    let sample = |i: u32| CurveSample {
        iteration: 100 * i,
        loss: 0.3 / f64::from(i + 1),
        l1: Some(0.1 / f64::from(i + 1)),
        ssim: Some(1.0 - 0.5 / f64::from(i + 1)),
        splats: 1000 + 50 * i as usize,
        elapsed_s: f64::from(i),
        psnr_train: Some(20.0 + f64::from(i).sqrt()),
        psnr_test: i.is_multiple_of(10).then(|| 19.0 + f64::from(i).sqrt()),
        psnr_test_sample: i.is_multiple_of(3).then(|| 18.0 + f64::from(i).sqrt()),
    };
    ReportInput {
        title: "a room & a lamp".into(),
        subtitle: "lcd, 3000 iterations".into(),
        facts: vec![("seed".into(), "42".into())],
        warnings: vec!["8-bit input is not HDR".into()],
        splits: mean
            .map(|mean| ReportSplit {
                name: "test".into(),
                mean,
                views: figures,
                mean_field: Some(field()),
                fields: vec![("images/000".into(), field())],
            })
            .into_iter()
            .collect(),
        curve: (0..30).map(sample).collect(),
        views,
        profile,
        config_toml: "iterations = 3000\n".into(),
        credits: vec!["scene by somebody".into()],
        mu: 5000.0,
        radiance_scale: RadianceScale::new(2.5).unwrap(),
        color_space: ColorSpace::LinearRec709,
    }
}

fn field() -> FieldMetrics {
    let decade = |decade, relative_error| DecadeError { decade, count: 1200, relative_error, bias: -0.01 };
    FieldMetrics {
        pu21_psnr: 31.25,
        pu21_ssim: 0.9321,
        pu21_peak_luminance: 1000.0,
        log_rmse: 0.0456,
        hdr_flip: Some(0.0789),
        relative_error_by_decade: vec![decade(-5, 0.5), decade(-1, 0.034), decade(4, 0.021)],
        ..FieldMetrics::default()
    }
}

#[test]
fn figures_without_a_mu_law_say_how_they_are_made() {
    let fields = vec![("images/000".into(), field())];
    let split = ReportSplit { name: "test".into(), mean: ViewMetrics::default(), views: Vec::new(), mean_field: Some(field()), fields };
    let section = field::section(&[split]);
    for part in ["31.25", "0.9321", "0.0456", "0.0789", "1000 cd/m²", "below 1e-4", "0.1 to 1", "from 1e4", "3.40 %", "-1.00 %"] {
        assert!(section.contains(part), "{part}: {section}");
    }
    // Nobody gave weights.
    assert!(!section.contains("LPIPS"), "{section}");
    assert_eq!(field::section(&[]), "");
}

/// The page with its pictures left out: base64 may spell anything.
fn without_pictures(page: &str) -> String {
    let mut parts = page.split("data:image/png;base64,");
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |out, part| out + part.split_once('"').map_or("", |(_, rest)| rest))
}

/// Checks that every element is closed in order, quotes close and no text holds a bare `<`; returns
/// the number of elements.
fn check_tags(page: &str) -> usize {
    const VOID: [&str; 3] = ["meta", "img", "input"];
    let (mut open, mut count, mut rest) = (Vec::new(), 0, page);
    while let Some(start) = rest.find('<') {
        rest = &rest[start + 1..];
        let mut quoted = false;
        let end = rest.find(|c| {
            quoted ^= c == '"';
            c == '>' && !quoted
        });
        let tag = &rest[..end.expect("a tag is not closed")];
        rest = &rest[tag.len() + 1..];
        assert!(!tag.contains('<'), "a tag within <{tag}>");
        let name = tag.trim_start_matches('/').split([' ', '/']).next().unwrap_or_default();
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name), "</{name}> closes another element");
        } else if !tag.starts_with('!') {
            assert!(name.chars().all(|c| c.is_ascii_alphanumeric()) && !name.is_empty(), "<{tag}>");
            count += 1;
            if !tag.ends_with('/') && !VOID.contains(&name) {
                open.push(name);
            }
        }
    }
    assert!(open.is_empty(), "left open: {open:?}");
    count
}

#[test]
fn the_page_is_well_formed_and_holds_every_section() {
    let page = page::page(&input((0..6).map(|i| view(&format!("images/{i:03}"), 40, 30, 0.02 * (i + 1) as f32)).collect())).unwrap();
    assert!(check_tags(&page) > 200);
    for heading in ["Metrics", "Training", "Error by luminance", "Views", "All other views", "Every view", "Configuration"] {
        assert!(page.contains(&format!("<h2>{heading}</h2>")), "{heading}");
    }
    // Four featured views with seven pictures, two small ones with three, two at the top.
    assert_eq!(page.matches("<img").count(), 4 * 7 + 2 * 3 + 2);
    let text = without_pictures(&page);
    assert!(!text.contains("NaN") && !text.contains(">inf"));
}

#[test]
fn nothing_is_loaded_from_anywhere() {
    let page = page::page(&input(vec![view("v", 20, 20, 0.1)])).unwrap();
    for reference in ["http", "//cdn", "@import", "url(", "<link", "<script", "<iframe"] {
        assert!(!without_pictures(&page).contains(reference), "{reference}");
    }
    assert_eq!(page.matches("src=\"").count(), page.matches("src=\"data:image/png;base64,").count());
}

#[test]
fn text_from_outside_is_escaped() {
    let evil = "</title><script>alert(\"x\" + 'y')</script>&";
    let mut hostile = input(vec![view(evil, 12, 12, 0.1)]);
    hostile.title = evil.into();
    hostile.subtitle = evil.into();
    hostile.facts = vec![(evil.into(), evil.into())];
    hostile.warnings = vec![evil.into()];
    hostile.config_toml = evil.into();
    hostile.credits = vec![evil.into()];
    hostile.splits[0].name = evil.into();
    let page = page::page(&hostile).unwrap();
    check_tags(&page);
    assert!(!page.contains("<script") && !page.contains("'y'"));
    assert!(page.contains("&lt;/title&gt;"));
}

#[test]
fn no_test_views_leave_a_page_that_says_so() {
    for input in [input(Vec::new()), ReportInput::default()] {
        let page = page::page(&input).unwrap();
        check_tags(&page);
        assert!(page.contains("No view was held out"));
        assert!(!page.contains("<img"));
    }
}

#[test]
fn odd_figures_and_images_are_shown_and_not_stumbled_over() {
    let mut views = vec![view("a", 1, 1, 0.0), view("b", 300, 2, 0.5), view("c", 2, 300, 0.5)];
    views[1].mask = Some(Mask::from_valid((0..600).map(|i| i % 3 != 0)).into());
    views[2].target = Image::filled(2, 300, [0.0; 3]);
    views[2].prediction = Image::filled(2, 300, [f32::MAX, 0.0, f32::NAN]);
    let broken = views[2].prediction.clone();
    views[2].prediction = Image::filled(2, 300, [0.5; 3]);
    let mut odd = input(views);
    odd.views[2].prediction = broken;
    odd.curve.push(CurveSample { loss: f64::NAN, elapsed_s: f64::INFINITY, psnr_test: Some(f64::NEG_INFINITY), ..odd.curve[3] });
    let page = page::page(&odd).unwrap();
    check_tags(&page);
    assert!(page.contains("≥ 100"), "equal images have the largest PSNR");
}

#[test]
fn a_size_mismatch_is_an_error() {
    let mut views = vec![view("a", 12, 10, 0.1)];
    views[0].prediction = Image::filled(5, 5, [0.0; 3]);
    let mut bad = input(vec![view("a", 12, 10, 0.1)]);
    bad.views = views;
    assert!(page::page(&bad).is_err());
}

#[test]
fn the_file_is_written_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("deep/report.html");
    write_report(&path, &input(vec![view("v", 16, 16, 0.1)])).unwrap();
    let page = std::fs::read_to_string(&path).unwrap();
    assert!(page.starts_with("<!doctype html>") && page.ends_with("</html>\n"));
    assert_eq!(std::fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
}
