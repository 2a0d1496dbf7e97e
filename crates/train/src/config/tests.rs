use super::*;

/// Sets options as a command line gives them: `--max-splats 9`, `--absgrad`.
fn parse(arguments: &[&str]) -> Result<TrainConfig, String> {
    let mut config = TrainConfig::base();
    let mut words = arguments.iter();
    while let Some(word) = words.next() {
        let option = OptionSpec::find(&word.trim_start_matches('-').replace('-', "_")).unwrap();
        option.set(&mut config, if option.is_switch() { "true" } else { words.next().unwrap() })?;
    }
    Ok(config)
}

#[test]
fn defaults_are_valid_and_those_of_the_table() {
    let config = parse(&[]).unwrap();
    assert_eq!(config, TrainConfig::default());
    config.validate().unwrap();
    assert_eq!(config.color_model().name(), "lcd");
    assert_eq!(config.loss_weights(), LossWeights { squared_share: 0.5, ..LossWeights::default() });
    // Equation 5 exactly as published.
    let paper = TrainConfig::from_preset(Preset::Paper).loss_weights();
    assert_eq!(paper, LossWeights { ssim_weight: 0.8, ..LossWeights::default() });
}

#[test]
fn the_start_follows_strategy_and_filter() {
    let scale = |arguments: &[&str]| parse(arguments).unwrap().initial_scale();
    assert_eq!(scale(&[]), 1.0);
    assert_eq!(scale(&["--antialias", "off"]), 1.0);
    assert_eq!(scale(&["--strategy", "mcmc"]), 0.3);
    assert_eq!(scale(&["--strategy", "mcmc", "--antialias", "mip"]), 0.3);
    // The value of 3DGS-MCMC.
    assert_eq!(scale(&["--strategy", "mcmc", "--antialias", "off"]), 0.1);
    assert_eq!(scale(&["--strategy", "mcmc", "--init-scale", "0.7"]), 0.7);
}

#[test]
fn tiny_numbers_are_refused_with_the_least() {
    let error = parse(&["--radiance-scale", "1e-38"]).unwrap().validate().unwrap_err().to_string();
    assert!(error.contains("found 1e-38, expected a number of at least 1.2e-38"), "{error}");
}

#[test]
fn every_option_changes_the_configuration() {
    let flags: &[&[&str]] = &[
        &["--preset", "paper"],
        &["--iterations", "7"],
        &["--early-end", "7"],
        &["--seed", "1"],
        &["--resolution-schedule", "off"],
        &["--crop", "200"],
        &["--method", "sh4"],
        &["--activation", "exp"],
        &["--chroma-degree", "2"],
        &["--luminance-degree", "1"],
        &["--sh-interval", "10"],
        &["--scale-rule", "max"],
        &["--radiance-scale", "2"],
        &["--background", "1,2,3"],
        &["--mu", "10"],
        &["--ssim-weight", "0.8"],
        &["--squared-share", "0"],
        &["--field-loss", "linear"],
        &["--field-network", "8x256"],
        &["--average-share", "0"],
        &["--dropout", "0.1"],
        &["--validation-share", "0.2"],
        &["--moments", "bf16"],
        &["--clearance", "0.1"],
        &["--batch", "2"],
        &["--batch-rule", "keep"],
        &["--refine-poses"],
        &["--refine-focal"],
        &["--pose-lr", "0.1"],
        &["--pose-from", "5"],
        &["--pose-until", "5"],
        &["--antialias", "off"],
        &["--samples", "2"],
        &["--samples-share", "0.5"],
        &["--cutoffs", "parity"],
        &["--freeze", "geometry"],
        &["--init-points", "5"],
        &["--stereo-points", "5"],
        &["--init-opacity", "0.3"],
        &["--init-scale", "0.5"],
        &["--strategy", "mcmc"],
        &["--hdr-weight", "1"],
        &["--cycle-weight", "1"],
        &["--cycle-lr", "1e-4"],
        &["--lift-width", "16"],
        &["--lift-lr", "1e-3"],
        &["--feature-lr", "1e-3"],
        &["--ldr-weight", "0.5"],
        &["--hdr-normalisation", "self"],
        &["--tone-width", "64"],
        &["--tone-lr", "0.001"],
        &["--exposure-compensation", "color"],
        &["--late-views", "whole"],
        &["--vignetting"],
        &["--noise-model", "0.1,0.01"],
        &["--unit-exposure", "0.7"],
        &["--max-splats", "10"],
        &["--pixels-per-splat", "10"],
        &["--turnover", "0"],
        &["--absgrad"],
        &["--densify-from", "1"],
        &["--densify-until", "2"],
        &["--densify-interval", "3"],
        &["--densify-threshold", "1"],
        &["--absgrad-threshold", "1"],
        &["--percent-dense", "0.1"],
        &["--prune-opacity", "0.1"],
        &["--prune-scale", "0.1"],
        &["--max-aspect", "20"],
        &["--prune-unseen", "0.1"],
        &["--opacity-reset-interval", "10"],
        &["--mcmc-growth", "0.1"],
        &["--mcmc-noise", "1"],
        &["--mcmc-opacity-weight", "1"],
        &["--mcmc-scale-weight", "1"],
        &["--position-lr", "1"],
        &["--position-lr-final", "1"],
        &["--sh-lr", "1"],
        &["--sh-lr-final", "1"],
        &["--luminance-lr", "1"],
        &["--luminance-lr-final", "1"],
        &["--opacity-lr", "1"],
        &["--opacity-lr-final", "1"],
        &["--scale-lr", "1"],
        &["--scale-lr-final", "1"],
        &["--rotation-lr", "1"],
    ];
    let is_listed = |name: &str| flags.iter().any(|flag| flag[0].trim_start_matches("--").replace('-', "_") == name);
    let missing: Vec<&str> = OPTIONS.iter().map(|option| option.name).filter(|name| !is_listed(name)).collect();
    assert!(missing.is_empty(), "add a flag of each of these options to this list: {missing:?}");
    let default = serde_json::to_value(TrainConfig::default()).unwrap();
    for flag in flags {
        let config = parse(flag).unwrap();
        // Options of poses are refused without poses to optimise, those of fields without one.
        let has_choice = ["--refine-focal", "--pose-lr", "--pose-from", "--pose-until"].contains(&flag[0]);
        let method = if flag[0].starts_with("--field-") { Method::NerfGrid } else { config.method };
        TrainConfig { refine_poses: has_choice || config.refine_poses, method, ..config.clone() }.validate().unwrap();
        let changed = serde_json::to_value(&config).unwrap();
        let field = flag[0].trim_start_matches('-').replace('-', "_");
        for (name, value) in changed.as_object().unwrap() {
            assert_eq!(*value != default[name], *name == field, "{flag:?} and field {name}");
        }
    }
}

#[test]
fn configuration_survives_json() {
    let config = parse(&[
        "--method",
        "lcd",
        "--activation",
        "relu",
        "--position-lr",
        "0.000123",
        "--background",
        "0.1",
        "--resolution-schedule",
        "2,1@9",
    ])
    .unwrap();
    let text = serde_json::to_string(&config).unwrap();
    assert_eq!(serde_json::from_str::<TrainConfig>(&text).unwrap(), config);
    assert!(serde_json::from_str::<TrainConfig>("{\"iteration\": 3}").unwrap_err().to_string().contains("unknown field"));
}

#[test]
fn nonsense_is_refused_with_the_options_name() {
    let cases: &[(&[&str], &str)] = &[
        (&["--method", "sh3", "--activation", "exp"], "activation"),
        (&["--chroma-degree", "6"], "chroma_degree"),
        (&["--luminance-degree", "4"], "luminance_degree"),
        (&["--iterations", "0"], "iterations"),
        (&["--radiance-scale", "0"], "radiance_scale"),
        (&["--radiance-scale", "nan"], "radiance_scale"),
        (&["--mu", "inf"], "mu"),
        (&["--mu", "0.9"], "mu"),
        (&["--ssim-weight", "1.5"], "ssim_weight"),
        (&["--densify-interval", "0"], "densify_interval"),
        (&["--turnover", "1.5"], "turnover"),
        (&["--max-aspect", "0.5"], "max_aspect"),
        (&["--prune-unseen", "inf"], "prune_unseen"),
        (&["--init-opacity", "0"], "init_opacity"),
        (&["--init-opacity", "1"], "init_opacity"),
        (&["--init-opacity", "nan"], "init_opacity"),
        (&["--init-scale", "0"], "init_scale"),
        (&["--sh-lr-final", "0"], "sh_lr_final"),
        (&["--scale-lr-final", "inf"], "scale_lr_final"),
        (&["--opacity-lr", "0", "--opacity-lr-final", "0.1"], "opacity_lr"),
        (&["--strategy", "mcmc", "--absgrad"], "absgrad"),
        (&["--strategy", "mcmc", "--percent-dense", "0.1"], "percent_dense"),
        (&["--refine-focal"], "refine_focal"),
        (&["--pose-from", "5"], "pose_from"),
        (&["--refine-poses", "--pose-lr", "0"], "pose_lr"),
        (&["--refine-poses", "--pose-from", "5", "--pose-until", "5"], "pose_until"),
    ];
    for (arguments, option) in cases {
        let error = parse(arguments).unwrap().validate().unwrap_err().to_string();
        assert!(error.starts_with(option), "{arguments:?}: {error}");
    }
    // Files may hold values that the command line refuses.
    for background in [[-1.0, 0.0, 0.0], [0.0, -1.0, 2.0], [f32::NAN, 0.0, 0.0], [1.0, 2.0, f32::NAN], [f32::INFINITY, 0.0, 0.0]] {
        let error = TrainConfig { background, ..TrainConfig::default() }.validate().unwrap_err().to_string();
        assert!(error.starts_with("background"), "{background:?}: {error}");
    }
    for bad in ["", "1,2", "1,2,3,4", "1,2,x", "1,2,nan", "1,2,-3", "1,2,inf"] {
        assert!(parse_rgb(bad).is_err(), "{bad}");
    }
    assert_eq!((parse_rgb("0, 0.5,2"), parse_rgb("0.5")), (Ok([0.0, 0.5, 2.0]), Ok([0.5; 3])));
    assert!(parse(&["--method", "sh9"]).is_err());
    assert_eq!(parse(&["--seed", "9223372036854775807"]).unwrap().seed, MAX_SEED);
    assert!(parse(&["--seed", "9223372036854775808"]).is_err());
    let error = TrainConfig { seed: MAX_SEED + 1, ..TrainConfig::default() }.validate().unwrap_err().to_string();
    assert!(error.starts_with("seed") && error.contains("at most 9223372036854775807"), "{error}");
    assert!(parse(&["--resolution-schedule", "4@0,2@x"]).unwrap_err().contains("\"x\" is not a step"));
}

#[test]
fn few_views_of_a_set_with_points_have_no_stereo_unless_a_number_is_given() {
    let points =
        |config: &TrainConfig| [(7, true), (8, true), (7, false)].map(|(views, has_points)| config.stereo_points_for(views, has_points));
    assert_eq!(points(&TrainConfig::default()), [0, 20_000, 20_000]);
    assert_eq!(points(&TrainConfig { stereo_points: Some(500), ..TrainConfig::default() }), [500; 3]);
    assert_eq!(points(&TrainConfig::from_preset(Preset::Paper)), [0; 3]);
}

#[test]
fn small_images_have_two_samples_along_a_pixels_side_unless_a_number_is_given() {
    let samples = |arguments: &[&str], px: u64| {
        parse(arguments).unwrap().with_preset(|name| name == "samples" && !arguments.is_empty()).samples_for(px)
    };
    assert_eq!([160_000, 200_000, 200_001, 24_000_000].map(|px| samples(&[], px)), [2, 2, 1, 1]);
    assert_eq!([160_000, 24_000_000].map(|px| samples(&["--samples", "3"], px)), [3, 3]);
    for method in ["hdr-gs", "mono-hdr-gs", "gausshdr", "lcd-anchors", "gausshdr-anchors"] {
        assert_eq!(samples(&["--method", method], 160_000), 1, "{method}");
    }
    assert_eq!(TrainConfig::from_preset(Preset::Paper).samples_for(160_000), 1);
}

#[test]
fn developed_photographs_have_a_luminance_that_varies_with_the_view_unless_degrees_are_given() {
    let degrees = |arguments: &[&str], is_developed: bool, scene: Option<ColorModel>| match parse(arguments)
        .unwrap()
        .with_degrees(is_developed, scene)
        .color_model()
    {
        ColorModel::Lcd { chroma_degree, luminance_degree, .. } => Some([chroma_degree, luminance_degree]),
        _ => None,
    };
    assert_eq!([false, true].map(|is_developed| degrees(&[], is_developed, None)), [Some([3, 0]), Some([1, 2])]);
    assert_eq!(degrees(&["--chroma-degree", "2"], true, None), Some([2, 0]));
    assert_eq!(degrees(&["--luminance-degree", "1"], true, None), Some([3, 1]));
    assert_eq!(degrees(&["--preset", "paper"], true, None), Some([3, 0]));
    assert_eq!(degrees(&["--method", "sh3"], true, None), None);
    // A scene keeps its own.
    let scene = ColorModel::Lcd { chroma_degree: 2, luminance_degree: 1, activation: luxel_core::Activation::Softplus };
    assert_eq!([false, true].map(|is_developed| degrees(&[], is_developed, Some(scene))), [Some([2, 1]); 2]);
    assert_eq!(degrees(&["--chroma-degree", "3"], true, Some(scene)), Some([3, 1]));
    assert_eq!(degrees(&[], true, Some(ColorModel::Sh { degree: 3 })), Some([3, 0]));
}

#[test]
fn a_method_is_stored_by_its_name() {
    for (method, value) in Method::VALUES {
        let text = serde_json::to_string(method).unwrap();
        assert_eq!(text, format!("\"{}\"", value.name));
        assert_eq!(serde_json::from_str::<Method>(&text).unwrap(), *method);
    }
}

#[test]
fn conditions_name_the_methods_that_meet_them() {
    for (condition, names) in [
        (Condition::Lcd, "lcd"),
        (Condition::LcdColors, "lcd or lcd-anchors"),
        (Condition::Field, "nerf-grid, hdr-nerf-grid or mono-hdr-nerf-grid"),
        (Condition::FieldOnRadiance, "nerf-grid"),
        (Condition::Pairs, "hdr-gs, mono-hdr-gs or mono-hdr-nerf-grid"),
        (Condition::ToneNetworks, "hdr-gs, gausshdr or gausshdr-anchors"),
        (Condition::Method(Method::GaussHdr), "gausshdr"),
    ] {
        assert_eq!((condition.option(), condition.value()), ("method", names));
        for (method, value) in Method::VALUES {
            let config = TrainConfig { method: *method, ..TrainConfig::default() };
            let is_named = names.split([',', ' ']).any(|name| name == value.name);
            assert_eq!(condition.is_met(&config), Some(is_named), "{condition:?}, {}", value.name);
        }
    }
}

#[test]
fn methods_with_networks_for_captured_images_have_the_steps_and_colours_of_their_rows() {
    let names = |holds: fn(Method) -> bool| {
        Method::VALUES.iter().filter(|(method, _)| holds(*method)).map(|(_, value)| value.name).collect::<Vec<_>>()
    };
    assert_eq!(names(Method::has_own_steps), ["hdr-gs", "mono-hdr-gs", "gausshdr"]);
    assert_eq!(names(Method::has_own_networks), ["hdr-gs", "mono-hdr-gs", "gausshdr", "gausshdr-anchors"]);
    assert_eq!(names(Method::lifts_colors), ["mono-hdr-gs"]);
    assert_eq!(names(|method| method.spec().values == ColorValues::Captured), ["mono-hdr-gs", "mono-hdr-nerf-grid"]);
    for (method, model) in [
        (Method::Lcd, "lcd-c1-l0"),
        (Method::Sh0, "sh0"),
        (Method::Sh3, "sh3"),
        (Method::Sh5, "sh5"),
        (Method::LogSh3, "logsh3"),
        (Method::HdrGs, "logsh3"),
        (Method::MonoHdrGs, "sh3"),
        (Method::GaussHdr, "logsh3"),
        (Method::LcdAnchors, "lcd-c0-l0"),
        (Method::GaussHdrAnchors, "logsh0"),
    ] {
        let config = TrainConfig { method, chroma_degree: Some(1), ..TrainConfig::default() };
        assert_eq!(config.color_model().name(), model, "{method:?}");
    }
}
