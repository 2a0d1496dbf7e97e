//! `luxel export -o scene.html`: the viewer's page with the scene in it.

use std::path::Path;

use anyhow::{Result, bail};
use luxel_app::run::ExplicitArgs;

use crate::args::{ExportArgs, flag};
use crate::output::console::Console;

/// Options of files with baked colours, which a page has no use for.
const OF_BAKES: [&str; 13] = [
    "bake",
    "output_color_space",
    "exposure",
    "tonemap",
    "degree",
    "refine",
    "origin",
    "rotate",
    "up",
    "scale",
    "scale_to",
    "metres_per_unit",
    "spz_version",
];

/// Returns whether the file to write is a page.
pub(super) fn is_page(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("html"))
}

/// Checks that no option was given that a page ignores.
fn check_options(path: &Path, explicit: &ExplicitArgs) -> Result<()> {
    if let Some(option) = OF_BAKES.into_iter().find(|option| explicit.contains(option)) {
        let flag = flag(option);
        bail!("{}: a page shows the scene's radiance as it is, {flag} is for files with baked colours; leave it out", path.display());
    }
    Ok(())
}

#[cfg(not(feature = "view"))]
pub(super) fn run(args: &ExportArgs, explicit: &ExplicitArgs, _console: &Console) -> Result<()> {
    check_options(&args.output, explicit)?;
    bail!(
        "{}: this program was built without the viewer, which the page is part of; write .ply, .usda, .glb, .spz or .sog",
        args.output.display()
    )
}

/// Writes the page; `explicit` names the options that were given.
#[cfg(feature = "view")]
pub(super) fn run(args: &ExportArgs, explicit: &ExplicitArgs, console: &Console) -> Result<()> {
    use luxel::export::choose_splats;
    use luxel_view::Subject;

    use crate::commands::view;
    use crate::inputs::engine;
    use crate::inputs::scene_source::{DataRequest, SceneSource};
    use crate::output::tree::Tree;

    check_options(&args.output, explicit)?;
    let source = SceneSource::open(&args.input.scene, console)?;
    let dataset = source.dataset(DataRequest::new(&args.input, explicit), console)?;
    let background = source.background_radiance();
    let mut scene = source.scene;
    let mut engine = engine::engine(&args.input.device)?.engine;
    choose_splats(&mut scene, &args.options(), dataset.as_ref(), engine.as_mut(), console)?;
    if let Some(most) = args.max_degree {
        luxel_view::limit_degree(&mut scene.splats, most);
    }
    let model = scene.splats.color_model.name();
    let scene = luxel::Scene::from(scene);
    let mut renderer = luxel::Renderer::with_engine(&scene, engine)?;
    renderer.set_background(background);
    let subject = Subject::new(view::name(&args.input.scene), &scene, dataset.as_ref())?;
    let bytes = luxel_view::write_page(&args.output, &subject, &scene, &mut renderer)?;
    let mut tree = Tree::default();
    tree.set("file", args.output.display().to_string()).set("splats", scene.splats.len());
    tree.set("file_bytes", bytes.file).set("poster_bytes", bytes.poster).set("thumbnail_bytes", bytes.thumbnails);
    tree.set("color_model", model);
    tree.set("color_space", scene.color_space.name());
    tree.set("precision", "exact, except harmonics above degree 0: half floats");
    tree.set("cameras", dataset.map_or(0, |dataset| dataset.train.len() + dataset.test.len()));
    console.finish(tree.json(), tree.text().trim_end())
}
