//! `luxel view`: the page in the browser, served until the program is stopped.

use std::net::SocketAddr;
use std::path::Path;

use anyhow::{Context, Result};
use luxel::display_lut::DisplayLut;
use luxel::{Device, Renderer, Scene};
use luxel_app::prepare::cd_m2_per_unit;
use luxel_app::run::ExplicitArgs;
use luxel_core::{ColorSpace, Dataset};
use luxel_io::{DisplayCurve, DisplayPrimaries, OcioDisplay};
use luxel_view::{Live, Other, Subject, Viewer};
use serde_json::json;

use crate::args::{DeviceArgs, ViewArgs};
use crate::inputs::engine;
use crate::inputs::scene_source::{DataRequest, SceneSource};
use crate::interrupt;
use crate::output::console::Console;

/// Serves the scene; `explicit` names the options that were given.
pub(crate) fn run(args: &ViewArgs, explicit: &ExplicitArgs) -> Result<()> {
    let console = Console::new(args.input.console.log_format, args.input.console.quiet);
    let viewer = Viewer::bind(args.listen)?;
    let display = args.ocio_look.open()?;
    if let Some(note) = display.as_ref().and_then(note_of_page) {
        console.note(&note);
    }
    let mesh = args.mesh.as_deref().map(proxy_mesh).transpose()?;
    let source = SceneSource::open(&args.input.scene, &console)?;
    let dataset = dataset(args, explicit, &source, &console)?;
    let cd_m2_per_unit = source.cd_m2_per_unit(DataRequest::new(&args.input, explicit));
    let other = args.with.as_deref().map(|path| other(path, args, &console)).transpose()?;
    let background = source.background_radiance();
    let scene = Scene::from(source.scene);
    let mut renderer = Renderer::with_engine(&scene, engine::engine(&device(args))?.engine)?;
    renderer.set_background(background);
    let subject =
        Subject::new(name(&args.input.scene), &scene, dataset.as_ref())?.saving_to(folder(&args.input.scene))?.opened_as(&args.input.scene);
    let subject = with_display(subject.with_cd_m2_per_unit(cd_m2_per_unit), display.as_ref(), scene.color_space)?;
    let subject = match mesh {
        Some(glb) => subject.with_mesh(glb),
        None => subject,
    };
    drop(dataset);
    announce(&viewer, !args.no_browser, &console)?;
    Ok(viewer.serve_beside(subject, scene, renderer, other.into_iter().collect(), interrupt::stop())?)
}

/// Returns what to say of a page that shows a display which the browser takes for another one.
fn note_of_page(display: &OcioDisplay) -> Option<String> {
    let is_usual =
        display.encoding().is_some_and(|encoding| encoding.primaries == DisplayPrimaries::Rec709 && encoding.curve != DisplayCurve::Pq);
    let name = display.display();
    (!is_usual).then(|| format!("the page shows the codes of the display {name}; the browser takes them for sRGB"))
}

/// Reads a proxy mesh for the page.
fn proxy_mesh(path: &Path) -> Result<Vec<u8>> {
    let bytes = std::fs::read(path).with_context(|| format!("{}: cannot read the mesh", path.display()))?;
    anyhow::ensure!(
        bytes.starts_with(b"glTF"),
        "{}: expected a mesh in binary glTF; make one with luxel mesh RUN -o proxy.glb",
        path.display()
    );
    Ok(bytes)
}

/// Gives the page the table of a display, if there is one.
fn with_display(subject: Subject, display: Option<&OcioDisplay>, color_space: ColorSpace) -> Result<Subject> {
    let Some(display) = display else { return Ok(subject) };
    Ok(subject.with_display(&DisplayLut::bake(display, color_space)?))
}

/// Opens the scene that is compared with, in an engine of its own.
fn other(path: &Path, args: &ViewArgs, console: &Console) -> Result<Other> {
    let source = SceneSource::open(path, console)?;
    let background = source.background_radiance();
    let scene = Scene::from(source.scene);
    let mut renderer = Renderer::with_engine(&scene, engine::engine(&device(args))?.engine)?;
    renderer.set_background(background);
    Ok(Other { name: name(path), scene, renderer })
}

/// Prints the address and opens it in a browser.
pub(crate) fn announce(viewer: &Viewer, with_browser: bool, console: &Console) -> Result<()> {
    let url = viewer.url();
    console.result(&json!({ "event": "viewer", "url": url }), &url)?;
    if with_browser && let Err(error) = open::that_detached(&url) {
        console.note(&format!("cannot open a browser ({error}); open the address by hand"));
    }
    Ok(())
}

/// Returns the observer of a training on `dataset` that shows it in the browser, and passes events
/// on.
pub(crate) fn live<'a>(address: SocketAddr, run: &Path, dataset: &Path, console: &'a Console) -> Result<Live<'a>> {
    let viewer = Viewer::bind(address)?;
    // Like all of the console's lines: on stderr, or an object on stdout.
    let url = viewer.url();
    console.event(&json!({ "event": "viewer", "url": url }), &format!("viewer {url}"));
    Ok(Live::new(viewer, name(run), interrupt::stop(), console).with_cd_m2_per_unit(cd_m2_per_unit(dataset)))
}

/// Returns the data set; without that of a run, which may be on another machine, the scene is shown
/// alone.
fn dataset(args: &ViewArgs, explicit: &ExplicitArgs, source: &SceneSource, console: &Console) -> Result<Option<Dataset>> {
    match source.dataset(DataRequest::new(&args.input, explicit), console) {
        Ok(dataset) => Ok(dataset),
        Err(error) if args.input.data.is_none() && source.run.is_some() => {
            console.warn(&format!("no cameras and no ground truth: {error:#}"));
            Ok(None)
        }
        Err(error) => Err(error),
    }
}

/// Returns the device: `auto` means the CPU, the only engine with depth.
fn device(args: &ViewArgs) -> DeviceArgs {
    let mut device = args.input.device.clone();
    if device.device == Device::Auto {
        device.device = Device::Cpu;
    }
    device
}

/// Returns the folder that the page saves into: the run's, or that of the scene file.
fn folder(path: &Path) -> &Path {
    match path.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        _ if path.is_dir() => path,
        Some(parent) => parent,
        None => Path::new("."),
    }
}

/// Returns the name that the page has for what is at a path.
pub(crate) fn name(path: &Path) -> String {
    let full = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    full.file_name().unwrap_or(full.as_os_str()).to_string_lossy().into_owned()
}
