//! The page with a scene in it, as one file that opens from disk.
//!
//! In: a scene, its [`Subject`], the renderer that has loaded it. Out: HTML that loads nothing
//! from anywhere: the modules of the page as `data:` addresses of an import map, the description of
//! the scene as JSON, its splats as compressed base64, with half floats for harmonics above degree
//! 0 ([`crate::splats`]). The page renders by itself, which needs WebGPU; what needs the server is
//! hidden. Without WebGPU it shows the pictures that it has: a render ([`crate::poster`]) and the
//! thumbnails of the cameras.

use std::io::Write;
use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::GzEncoder;
use luxel::{Error, Remedy, Renderer, Result};
use luxel_core::{ColorModel, OnDemand, RenderOptions, Scene, Splats};
use serde_json::{Map, Value, json};

use crate::assets::{self, ASSETS};
use crate::poster;
use crate::splats::{Precision, pack};
use crate::subject::{Shown, Subject};
use crate::thumbnail;

/// Characters of the splats, at most: browsers hold no longer text.
const MAX_TEXT: usize = 500_000_000;
/// Bytes of thumbnails, at most; cameras after that have none.
const MAX_THUMBNAIL_BYTES: usize = 2 << 20;
/// The first line of the page's script in `index.html`, which the file replaces.
const SCRIPT: &str = r#"<script type="module" src="/page/main.js"></script>"#;
const STYLE: &str = r#"<link rel="stylesheet" href="/page/style.css">"#;
const ICON: &str = r#"<link rel="icon" href="/page/icon.svg">"#;
/// Nothing is loaded, and nothing leaves the page.
const POLICY: &str = "default-src 'none'; script-src 'unsafe-inline' data:; style-src 'unsafe-inline'; img-src data: blob:";

/// The bytes of a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PageBytes {
    /// All of it.
    pub file: usize,
    /// The picture that is shown where the page cannot render, as JPEG.
    pub poster: usize,
    /// The thumbnails of the cameras, as JPEG.
    pub thumbnails: usize,
}

/// Writes the page with `scene` in it, which `renderer` has loaded, whole or not at all.
///
/// # Errors
/// A scene that is too large for a browser; a device that gave up; the file system's refusal.
pub fn write_page(path: &Path, subject: &Subject, scene: &Scene, renderer: &mut Renderer) -> Result<PageBytes> {
    if scene.splats.color_model.single().is_none() {
        let message = format!("{}: a page does not render a mix of lights", path.display());
        let remedy = Remedy::advice("open it with luxel view, or write .glb or .ply");
        return Err(Error::new(message).with_remedy(remedy));
    }
    let poster = poster::jpeg(subject, renderer)?;
    let thumbnails = thumbnails(subject);
    let bytes = PageBytes { file: 0, poster: poster.len(), thumbnails: thumbnails.iter().map(|(_, jpeg)| jpeg.len()).sum() };
    let page = page(subject, scene, renderer.options(), Pictures { poster, thumbnails })?;
    let write =
        |out: &mut (dyn luxel_io::WriteSeek + '_)| out.write_all(page.as_bytes()).map_err(|e| luxel_io::IoError::system(path, "write", &e));
    luxel_io::write_atomically(path, write)?;
    Ok(PageBytes { file: page.len(), ..bytes })
}

/// The pictures of a page, as JPEG.
#[derive(Default)]
struct Pictures {
    poster: Vec<u8>,
    /// By the names of the cameras.
    thumbnails: Vec<(String, Vec<u8>)>,
}

/// Returns a picture as an address.
fn data_address(jpeg: &[u8]) -> String {
    format!("data:image/jpeg;base64,{}", STANDARD.encode(jpeg))
}

/// Lowers the degree of the harmonics to at most `most`: the rest is left out.
pub fn limit_degree(splats: &mut Splats, most: u8) {
    let color_model = match splats.color_model {
        ColorModel::Sh { degree } => ColorModel::Sh { degree: degree.min(most) },
        ColorModel::LogSh { degree } => ColorModel::LogSh { degree: degree.min(most) },
        ColorModel::Lcd { chroma_degree, luminance_degree, activation } => {
            ColorModel::Lcd { chroma_degree: chroma_degree.min(most), luminance_degree: luminance_degree.min(most), activation }
        }
        // No page renders a mix.
        ColorModel::Mix(_) => return,
    };
    let first = |values: &[f32], had: usize, has: usize| match had {
        0 => Vec::new(),
        _ => values.chunks(had).flat_map(|row| row.iter().take(has)).copied().collect(),
    };
    let before = splats.color_model;
    splats.sh = first(&splats.sh, 3 * before.sh_coefficients(), 3 * color_model.sh_coefficients());
    splats.raw_luminance = first(&splats.raw_luminance, before.luminance_coefficients(), color_model.luminance_coefficients());
    splats.color_model = color_model;
}

fn page(subject: &Subject, scene: &Scene, options: &RenderOptions, pictures: Pictures) -> Result<String> {
    let cannot = |error: std::io::Error| Error::new(format!("cannot compress the scene: {error}"));
    let mut packed = GzEncoder::new(Vec::new(), Compression::default());
    packed.write_all(&pack(scene, options, Precision::Half)).map_err(cannot)?;
    let splats = STANDARD.encode(packed.finish().map_err(cannot)?);
    if splats.len() > MAX_TEXT {
        let message = format!("the page would take {} MB, browsers read {} MB at most", splats.len() / 1_000_000, MAX_TEXT / 1_000_000);
        return Err(Error::new(message).with_remedy(Remedy::lower("max_splats")));
    }
    // An end of a script in a name must not end the script.
    let facts = facts(subject, scene, pictures).to_string().replace('<', "\\u003c");
    let modules = format!(
        "<meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\">\n\
         <script type=\"importmap\">{}</script>\n\
         <script type=\"application/json\" id=\"luxel-scene\">{facts}</script>\n\
         <script type=\"application/octet-stream\" id=\"luxel-splats\">{splats}</script>\n\
         <script type=\"module\">import \"luxel/main.js\";</script>",
        import_map()
    );
    let data = |name: &str| assets::asset(name).map_or("", |asset| asset.content);
    let icon = format!("<link rel=\"icon\" href=\"data:image/svg+xml;base64,{}\">", STANDARD.encode(data("icon.svg")));
    let style = format!("<style>{}</style>", data("style.css"));
    let page = assets::index(&subject.facts.name);
    Ok(page.replace(STYLE, &style).replace(ICON, &icon).replace(SCRIPT, &modules))
}

/// Returns what the server answers at `/api/scene`, with pictures, and without ground truth.
fn facts(subject: &Subject, scene: &Scene, Pictures { poster, thumbnails }: Pictures) -> Value {
    let thumbnails: Map<String, Value> = thumbnails.into_iter().map(|(name, jpeg)| (name, data_address(&jpeg).into())).collect();
    let mut facts = serde_json::to_value(&subject.facts).unwrap_or_default();
    let mut cameras = serde_json::to_value(subject.cameras()).unwrap_or_default();
    for camera in cameras.as_array_mut().into_iter().flatten() {
        camera["has_ground_truth"] = false.into();
    }
    let more = json!({
        "splats": scene.splats.len(), "version": 0, "cameras_version": 0, "training": null, "download_bytes": null, "lights": 1, "cameras": cameras,
        "luxel_version": luxel::VERSION, "thumbnails": thumbnails, "poster": data_address(&poster),
        "chromaticities": scene.color_space.chromaticities(), "color_interop_id": luxel_io::color_interop_id(scene.color_space),
    });
    if let (Value::Object(facts), Value::Object(more)) = (&mut facts, more) {
        facts.extend(more);
    }
    facts
}

/// Returns small pictures of the cameras' ground truth by name, as JPEG.
fn thumbnails(subject: &Subject) -> Vec<(String, Vec<u8>)> {
    let (scale, space) = (subject.facts.radiance_scale, subject.color_space);
    let mut thumbnails = Vec::new();
    let mut bytes = 0;
    for Shown { name, truth, .. } in &subject.views {
        let Some(Ok(image)) = truth.as_ref().map(OnDemand::loaded) else { continue };
        let Ok(jpeg) = thumbnail::jpeg(&image, scale, space) else { continue };
        bytes += jpeg.len();
        if bytes > MAX_THUMBNAIL_BYTES {
            break;
        }
        thumbnails.push((name.clone(), jpeg));
    }
    thumbnails
}

/// Returns the map from the names of the page's modules to their texts.
fn import_map() -> Value {
    let modules = ASSETS.iter().filter(|(name, _)| name.ends_with(".js")).map(|(name, asset)| {
        let text = STANDARD.encode(with_bare_names(name, asset.content));
        (format!("luxel/{name}"), Value::from(format!("data:text/javascript;base64,{text}")))
    });
    json!({ "imports": modules.collect::<Map<_, _>>() })
}

/// Gives imports names that do not depend on the address of the module, which has none in a file.
fn with_bare_names(module: &str, text: &str) -> String {
    let folder = module.rsplit_once('/').map_or("", |(folder, _)| folder);
    let line = |line: &str| {
        let is_import = ["import ", "export ", "} from "].iter().any(|start| line.starts_with(start));
        let Some((before, rest)) = line.split_once(" \"").filter(|_| is_import) else { return format!("{line}\n") };
        let name = match (rest.strip_prefix("./"), rest.strip_prefix("../")) {
            (Some(name), _) if folder.is_empty() => name.to_owned(),
            (Some(name), _) => format!("{folder}/{name}"),
            (_, Some(name)) => name.to_owned(),
            _ => return format!("{line}\n"),
        };
        format!("{before} \"luxel/{name}\n")
    };
    text.lines().map(line).collect()
}

#[cfg(test)]
mod tests {
    use luxel::synthetic;

    use super::*;

    #[test]
    fn every_import_of_the_page_is_in_the_map() {
        let map = import_map();
        for (name, asset) in ASSETS.iter().filter(|(name, _)| name.ends_with(".js")) {
            let text = with_bare_names(name, asset.content);
            for line in text.lines().filter(|line| !line.trim_start().starts_with(['*', '/'])) {
                assert!(!line.contains("from \".") && !line.contains("import \"."), "{name}: {line}");
                for imported in line.split('"').filter(|part| part.starts_with("luxel/")) {
                    assert!(map["imports"][imported].is_string(), "{name} imports {imported}");
                }
            }
            assert_eq!(text.lines().count(), asset.content.lines().count());
        }
    }

    #[test]
    fn the_file_holds_the_scene_and_loads_nothing() {
        let scene = synthetic::room(20, 1);
        let subject = Subject::new("a</script>b", &scene, None).unwrap();
        let pictures = Pictures { poster: vec![1, 2, 3], thumbnails: vec![("a".into(), vec![4])] };
        let page = page(&subject, &scene, &scene.render_options(), pictures).unwrap();
        assert!(!page.contains("src=\"/") && !page.contains("href=\"/") && !page.contains("a</script>b"));
        let part = |id: &str| page.split_once(&format!("id=\"{id}\">")).unwrap().1.split_once("</script>").unwrap().0;
        let facts: Value = serde_json::from_str(part("luxel-scene")).unwrap();
        assert_eq!((&facts["name"], &facts["splats"]), (&"a</script>b".into(), &20.into()));
        assert_eq!(facts["poster"], "data:image/jpeg;base64,AQID");
        assert_eq!(facts["thumbnails"], json!({ "a": "data:image/jpeg;base64,BA==" }));
        assert_eq!(facts["chromaticities"].as_array().map(Vec::len), Some(4));
        assert_eq!(facts["color_interop_id"], "lin_rec709_scene");
        let packed = STANDARD.decode(part("luxel-splats")).unwrap();
        let mut splats = Vec::new();
        std::io::Read::read_to_end(&mut flate2::read::GzDecoder::new(&packed[..]), &mut splats).unwrap();
        assert!(splats == pack(&scene, &scene.render_options(), Precision::Half));
    }

    #[test]
    fn a_lower_degree_keeps_the_first_harmonics() {
        let mut scene = Scene::clone(&synthetic::room(5, 1));
        let before = scene.splats.clone();
        limit_degree(&mut scene.splats, 1);
        assert_eq!(scene.splats.color_model.sh_degree(), before.color_model.sh_degree().min(1));
        assert!(scene.splats.validate().is_ok());
        for splat in 0..5 {
            let kept = scene.splats.sh_of(splat);
            assert_eq!(kept, &before.sh_of(splat)[..kept.len()]);
        }
    }
}
