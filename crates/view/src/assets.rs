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
    script!("aperture.js"),
    script!("clicks.js"),
    script!("comparison.js"),
    script!("connection.js"),
    script!("controls.js"),
    script!("display.js"),
    script!("dropping.js"),
    script!("edit-cards.js"),
    script!("edits.js"),
    script!("embedded.js"),
    script!("environment.js"),
    script!("exposure.js"),
    script!("exr.js"),
    script!("falsecolor.js"),
    script!("gpu/device.js"),
    script!("gpu/forward.js"),
    script!("gpu/hdrshader.js"),
    script!("gpu/layers.js"),
    script!("gpu/passes.js"),
    script!("gpu/renderer.js"),
    script!("gpu/splats.js"),
    script!("folding.js"),
    script!("half.js"),
    script!("handles.js"),
    script!("hdr.js"),
    script!("help.js"),
    script!("legend.js"),
    script!("lens.js"),
    script!("lights.js"),
    script!("local.js"),
    script!("main.js"),
    script!("math.js"),
    script!("measure.js"),
    script!("messages.js"),
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
    script!("ocio.js"),
    script!("optics.js"),
    script!("overlay.js"),
    script!("pace.js"),
    script!("panel.js"),
    script!("part.js"),
    script!("path.js"),
    script!("pathrender.js"),
    script!("picking.js"),
    script!("places.js"),
    script!("plots.js"),
    script!("poster.js"),
    script!("probes.js"),
    script!("projections.js"),
    script!("radiometry.js"),
    script!("rendering.js"),
    script!("saving.js"),
    script!("scene.js"),
    script!("selected.js"),
    script!("selection.js"),
    script!("server.js"),
    script!("shader.js"),
    script!("shading.js"),
    script!("source.js"),
    script!("sources.js"),
    script!("stack.js"),
    script!("state.js"),
    script!("stream.js"),
    script!("strip.js"),
    script!("timeline.js"),
    script!("training.js"),
    script!("units.js"),
    script!("variant.js"),
    script!("viewer.js"),
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
