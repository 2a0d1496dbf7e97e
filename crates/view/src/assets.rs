//! The page: its files are part of the program, so that nothing is fetched from anywhere.

/// A file of the page.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Asset {
    pub(crate) content: &'static str,
    pub(crate) media_type: &'static str,
}

macro_rules! script {
    ($name:literal) => {
        ($name, Asset { content: include_str!(concat!("page/", $name)), media_type: "text/javascript; charset=utf-8" })
    };
}

/// The document, in which [`TITLE`] stands for the scene's name.
pub(crate) const INDEX: &str = include_str!("page/index.html");

/// The place of the scene's name in [`INDEX`].
pub(crate) const TITLE: &str = "{{title}}";

/// All files but the document.
pub(crate) const ASSETS: &[(&str, Asset)] = &[
    ("style.css", Asset { content: include_str!("page/style.css"), media_type: "text/css; charset=utf-8" }),
    ("icon.svg", Asset { content: include_str!("page/icon.svg"), media_type: "image/svg+xml" }),
    script!("main.js"),
    script!("camera/aperture.js"),
    script!("camera/controls.js"),
    script!("camera/optics.js"),
    script!("camera/places.js"),
    script!("camera/strip.js"),
    script!("display/choices.js"),
    script!("display/display.js"),
    script!("display/exposure.js"),
    script!("display/falsecolor.js"),
    script!("display/hdr-shader.js"),
    script!("display/hdr.js"),
    script!("display/legend.js"),
    script!("display/ocio.js"),
    script!("display/shader.js"),
    script!("dom/elements.js"),
    script!("dom/files.js"),
    script!("dom/folding.js"),
    script!("dom/messages.js"),
    script!("dom/pace.js"),
    script!("edit/cards.js"),
    script!("edit/edits.js"),
    script!("edit/handles.js"),
    script!("edit/lights.js"),
    script!("edit/picking.js"),
    script!("edit/selected.js"),
    script!("edit/selection.js"),
    script!("edit/stack.js"),
    script!("gpu/device.js"),
    script!("gpu/forward.js"),
    script!("gpu/layers.js"),
    script!("gpu/passes.js"),
    script!("gpu/renderer.js"),
    script!("gpu/splats.js"),
    script!("math/half.js"),
    script!("math/lens.js"),
    script!("math/projections.js"),
    script!("math/vectors.js"),
    script!("measure/comparison.js"),
    script!("measure/environment.js"),
    script!("measure/probes.js"),
    script!("measure/radiometry.js"),
    script!("object/ball.js"),
    script!("object/bvh.js"),
    script!("object/glb.js"),
    script!("object/lamps.js"),
    script!("object/mesh.js"),
    script!("object/meshlamp.js"),
    script!("object/placed.js"),
    script!("object/proxy.js"),
    script!("object/raster.js"),
    script!("object/shading.js"),
    script!("object/shadow.js"),
    script!("object/solid.js"),
    script!("object/surface.js"),
    script!("object/teapot.js"),
    script!("path/frames.js"),
    script!("path/path.js"),
    script!("path/timeline.js"),
    script!("picture/exr.js"),
    script!("picture/pixels.js"),
    script!("picture/units.js"),
    script!("scene/connection.js"),
    script!("scene/embedded.js"),
    script!("scene/local.js"),
    script!("scene/poster.js"),
    script!("scene/rendering.js"),
    script!("scene/scene.js"),
    script!("scene/server.js"),
    script!("scene/shading.js"),
    script!("scene/source.js"),
    script!("scene/sources.js"),
    script!("scene/stream.js"),
    script!("scene/variant.js"),
    script!("training/plots.js"),
    script!("training/training.js"),
    script!("viewer/clicks.js"),
    script!("viewer/help.js"),
    script!("viewer/overlay.js"),
    script!("viewer/panel.js"),
    script!("viewer/part.js"),
    script!("viewer/saving.js"),
    script!("viewer/state.js"),
    script!("viewer/viewer.js"),
];

/// Returns the file of this name.
pub(crate) fn asset(name: &str) -> Option<Asset> {
    ASSETS.iter().find(|(known, _)| *known == name).map(|(_, asset)| *asset)
}

/// Returns the document for a scene of this name.
pub(crate) fn index(name: &str) -> String {
    let escaped: String = name.chars().map(|c| if "&<>\"'".contains(c) { format!("&#{};", u32::from(c)) } else { c.to_string() }).collect();
    INDEX.replace(TITLE, &escaped)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_text_in_the_document() {
        let page = index("<script>alert('a')</script>");
        assert!(page.contains("<title>&#60;script&#62;alert(&#39;a&#39;)") && !page.contains(TITLE));
    }

    #[test]
    fn the_page_loads_nothing_from_elsewhere() {
        for (name, asset) in ASSETS {
            let has_address = asset.content.lines().any(|line| line.contains("://") && !line.contains("http://www.w3.org/"));
            assert!(!has_address, "{name}");
        }
    }
}
