//! The viewer as a program over HTTP sees it: what it answers, what it refuses, what it survives.
#![allow(missing_docs, clippy::unwrap_used, reason = "tests")]

mod common;

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use luxel::photograph::{Aperture, Photograph, Sampling};
use luxel::{Device, Edit, RadianceLayers, Renderer, Scene, synthetic};
use luxel_core::tone::srgb_encode;
use luxel_core::{ColorSpace, RadianceScale, Similarity};
use luxel_io::{ReadOptions, decode_image};
use luxel_view::solids::{Shape, SolidOptions};
use serde_json::Value;

use common::Running;

#[test]
fn the_page_and_the_scene_are_served() {
    let viewer = Running::start("127.0.0.1:0");
    assert_eq!(viewer.url, format!("http://{}/", viewer.address));
    let page = viewer.get("/");
    let text = String::from_utf8(page.body).unwrap();
    assert!(page.status == 200 && text.contains("<title>balls &#60;1&#62;</title>") && text.contains("<canvas"));
    assert!(page.head.contains("content-security-policy: default-src 'none'") && page.head.contains("nosniff"));
    for name in text.split('"').filter_map(|part| part.strip_prefix("/page/")) {
        assert_eq!(viewer.get(&format!("/page/{name}")).status, 200, "{name}");
    }
    let scene = viewer.json("/api/scene");
    assert_eq!((&scene["schema_version"], &scene["splats"], &scene["color_space"]), (&1.into(), &300.into(), &"linear-rec709".into()));
    assert_eq!(scene["cameras"].as_array().unwrap().len(), 9);
    assert_eq!((&scene["cameras"][0]["name"], &scene["cameras"][0]["w"]), (&"images/000".into(), &24.into()));
    for path in ["/nothing", "/page/../Cargo.toml", "/page/main.rs", "/api/frame.png", "//", "/page/%2e%2e/main.js"] {
        assert_eq!(viewer.get(path).status, 404, "{path}");
    }
}

#[test]
fn the_exr_is_what_the_renderer_writes() {
    let viewer = Running::start("127.0.0.1:0");
    let camera = &viewer.dataset.train[0].camera;
    let name = &viewer.dataset.train[0].name;
    let mut renderer = Renderer::new(&viewer.scene, Device::Cpu).unwrap();
    let served = viewer.get(&format!("/api/frame.exr?view={name}"));
    assert!(served.status == 200 && served.body == renderer.render(camera).unwrap().encode_exr().unwrap());

    let layers = viewer.get(&format!("/api/frame.exr?view={name}&channels=rgb,depth,alpha"));
    assert_eq!(layers.body, renderer.render_layers(camera).unwrap().encode_exr(true, true).unwrap());

    let scene = viewer.json("/api/scene");
    let frame = scene["cameras"].as_array().unwrap().iter().find(|camera| camera["name"] == name.as_str()).unwrap();
    let encoded: String = frame.to_string().bytes().map(|byte| format!("%{byte:02x}")).collect();
    let posed = viewer.get(&format!("/api/frame.exr?camera={encoded}&width=24&height=24"));
    let read = |bytes: &[u8]| decode_image("a.exr".as_ref(), bytes, &ReadOptions::default()).unwrap().image;
    let (posed, named) = (read(&posed.body), read(&served.body));
    let near = |a: &f32, b: &f32| (a - b).abs() <= 1e-3 * a.abs().max(1e-3);
    assert!(posed.pixels.as_flattened().iter().zip(named.pixels.as_flattened()).all(|(a, b)| near(a, b)));

    let edited = viewer.get(&format!("/api/frame.exr?view={name}&edit=gain+0.5"));
    let mut scene = viewer.scene.clone();
    scene.edit(&"gain 0.5".parse::<Edit>().unwrap()).unwrap();
    renderer.replace_scene(&scene).unwrap();
    assert_eq!(edited.body, renderer.render(camera).unwrap().encode_exr().unwrap());
    // The scene itself is unchanged.
    assert_eq!(viewer.get(&format!("/api/frame.exr?view={name}")).body, served.body);
}

#[test]
fn a_probe_and_a_frame_hold_the_values_of_the_render() {
    let viewer = Running::start("127.0.0.1:0");
    let view = &viewer.dataset.test[0];
    let mut renderer = Renderer::new(&viewer.scene, Device::Cpu).unwrap();
    let layers = renderer.render_layers(&view.camera).unwrap();
    let frame = viewer.get(&format!("/api/frame?view={}&channels=rgb,alpha,depth", view.name));
    let line = frame.head.lines().find_map(|line| line.strip_prefix("luxel-frame: ")).unwrap();
    let head: Value = serde_json::from_str(line).unwrap();
    assert_eq!((&head["width"], &head["height"], &head["depth"]), (&24.into(), &24.into(), &true.into()));
    assert_eq!(frame.body.len(), 24 * 24 * (6 + 2 + 4));
    for (x, y) in [(0, 0), (12, 12), (23, 5)] {
        let probe = viewer.json(&format!("/api/probe?view={}&x={x}&y={y}", view.name));
        let expected = layers.radiance.pixel(x, y).unwrap();
        let (index, scale) = (y * 24 + x, head["scale"].as_f64().unwrap());
        for (c, value) in expected.iter().enumerate() {
            assert_eq!(probe["radiance"][c].as_f64().unwrap() as f32, *value);
            let at = 2 * (3 * index + c);
            let half = u16::from_le_bytes([frame.body[at], frame.body[at + 1]]);
            let held = f64::from(half_to_f32(half)) * scale;
            assert!((held - f64::from(*value)).abs() <= 4.9e-4 * f64::from(value.abs()), "{held} for {value}");
        }
        let depth = layers.depth[index];
        let at = 24 * 24 * 8 + 4 * index;
        assert_eq!(f32::from_le_bytes(frame.body[at..at + 4].try_into().unwrap()), depth);
        if depth.is_finite() {
            assert_eq!(probe["depth"].as_f64().unwrap() as f32, depth);
            let position: Vec<f64> = probe["position"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
            let (pixel, found) = view.camera.project([position[0], position[1], position[2]].into()).unwrap();
            assert!((pixel.x - x as f64 - 0.5).abs() < 1e-6 && (found - f64::from(depth)).abs() < 1e-6);
        }
    }
    let truth = viewer.get(&format!("/api/truth?view={}", view.name));
    assert_eq!((truth.status, truth.body.len()), (200, 24 * 24 * 6));
    assert!(viewer.get(&format!("/api/thumbnail?view={}", view.name)).body.starts_with(&[0xff, 0xd8]));
}

#[test]
fn colours_of_a_display_are_light_in_the_page_and_stay_as_they_are_in_files() {
    let mut scene = synthetic::room(300, 1).into_core();
    scene.color_space = ColorSpace::DisplaySrgb;
    scene.radiance_scale = RadianceScale::ONE;
    let viewer = Running::show("127.0.0.1:0", scene.into(), Vec::new());
    let facts = viewer.json("/api/scene");
    assert_eq!((&facts["is_display"], &facts["color_space"]), (&true.into(), &"display-srgb".into()));
    let view = &viewer.dataset.test[0];
    let stored = Renderer::new(&viewer.scene, Device::Cpu).unwrap().render(&view.camera).unwrap();
    let file = viewer.get(&format!("/api/frame.exr?view={}", view.name));
    assert_eq!(file.body, stored.encode_exr().unwrap());
    let frame = viewer.get(&format!("/api/frame?view={}", view.name));
    let head: Value = serde_json::from_str(frame.head.lines().find_map(|line| line.strip_prefix("luxel-frame: ")).unwrap()).unwrap();
    let scale = head["scale"].as_f64().unwrap() as f32;
    let halves = frame.body.chunks(2).map(|pair| half_to_f32(u16::from_le_bytes([pair[0], pair[1]])) * scale);
    for (light, code) in halves.zip(stored.pixels().as_flattened()) {
        // Without a curve the page shows the code.
        assert!((srgb_encode(light) - code).abs() < 1e-3 * code.max(0.1), "light {light} of {code}");
    }
    let probe = viewer.json(&format!("/api/probe?view={}&x=12&y=12", view.name));
    let (found, code) = (probe["radiance"][1].as_f64().unwrap() as f32, stored.pixel(12, 12).unwrap()[1]);
    assert!((srgb_encode(found) - code).abs() < 1e-5, "{found} of {code}");
}

fn half_to_f32(bits: u16) -> f32 {
    let (exponent, mantissa) = (i32::from(bits >> 10 & 31), f32::from(bits & 1023));
    let size = if exponent == 0 { mantissa * 2f32.powi(-24) } else { (1.0 + mantissa / 1024.0) * 2f32.powi(exponent - 15) };
    if bits & 0x8000 == 0 { size } else { -size }
}

/// A frame of transforms.json as a parameter.
fn encoded(frame: &Value) -> String {
    frame.to_string().bytes().map(|byte| format!("%{byte:02x}")).collect()
}

#[test]
fn far_scenes_are_served_in_the_coordinates_of_the_world() {
    // The room's world is four times as large and at UTM coordinates.
    let origin = glam::DVec3::new(455_123.0, 4_600_321.0, 212.0);
    let world = Similarity::new(glam::DMat3::IDENTITY, 4.0, origin).unwrap();
    let mut scene = synthetic::room(300, 1).into_core();
    scene.world_from_local = world;
    let viewer = Running::show("127.0.0.1:0", scene.into(), Vec::new());
    let facts = viewer.json("/api/scene");
    let low: Vec<f64> = facts["bounds"][0].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    assert!((low[0] - origin.x).abs() < 100.0 && (low[1] - origin.y).abs() < 100.0, "{low:?}");
    assert_eq!((&facts["world_from_local"]["scale"], &facts["cd_m2_per_unit"]), (&4.0.into(), &2.0.into()));

    // A camera inside of the room, in the world.
    let local = synthetic::room_camera([40, 30]);
    let mut posed = local.clone();
    world.apply_to_camera(&mut posed);
    let (axes, eye) = (posed.camera_from_world.matrix3.transpose(), posed.eye());
    let row = |i: usize| serde_json::json!([axes.col(0)[i], -axes.col(1)[i], -axes.col(2)[i], eye[i]]);
    let frame = serde_json::json!({
        "transform_matrix": [row(0), row(1), row(2), [0, 0, 0, 1]], "fl_x": local.focal_px.x, "fl_y": local.focal_px.y,
        "cx": local.center_px.x, "cy": local.center_px.y, "w": 40, "h": 30,
    });
    let mut renderer = Renderer::new(&viewer.scene, Device::Cpu).unwrap();
    let layers = renderer.render_layers(&local).unwrap();
    let places = [(3, 4), (20, 15), (30, 22), (10, 28)];
    for (x, y) in places {
        let probe = viewer.json(&format!("/api/probe?camera={}&x={x}&y={y}", encoded(&frame)));
        let (expected, depth) = (layers.radiance.pixel(x, y).unwrap(), layers.depth[y * 40 + x]);
        for (c, value) in expected.iter().enumerate() {
            assert!((probe["radiance"][c].as_f64().unwrap() - f64::from(*value)).abs() <= 1e-4 * f64::from(value.abs()) + 1e-6);
        }
        let Some(found) = probe["depth"].as_f64() else { panic!("no depth at {x}, {y}, where the room has a wall") };
        assert!((found / f64::from(depth) - 1.0).abs() < 1e-4);
        let position: Vec<f64> = probe["position"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
        let (pixel, z) = posed.project([position[0], position[1], position[2]].into()).unwrap();
        assert!((pixel.x - x as f64 - 0.5).abs() < 1e-4 && (z - found).abs() < 1e-4 * z, "{pixel} {z}");
    }
}

#[test]
fn a_second_scene_is_rendered_from_the_same_cameras() {
    let (first, mut second) = (synthetic::room(300, 1), synthetic::room(200, 2).into_core());
    // The same place, held in other coordinates.
    let moved = Similarity::new(glam::DMat3::IDENTITY, 2.0, glam::DVec3::new(0.5, -1.0, 2.0)).unwrap();
    second.move_to(moved);
    let second = Scene::from(second);
    let viewer = Running::show("127.0.0.1:0", first, vec![second.clone()]);
    let facts = viewer.json("/api/scene");
    assert_eq!((&facts["others"][0]["name"], &facts["others"][0]["splats"]), (&"other".into(), &200.into()));
    let view = &viewer.dataset.train[0];
    let mut renderer = Renderer::new(&second, Device::Cpu).unwrap();
    let expected = renderer.render(&second.local_camera(&view.camera)).unwrap().encode_exr().unwrap();
    assert_eq!(viewer.get(&format!("/api/frame.exr?view={}&scene=1", view.name)).body, expected);
    assert_ne!(viewer.get(&format!("/api/frame.exr?view={}", view.name)).body, expected);
    assert_eq!(viewer.get(&format!("/api/frame?view={}&scene=2", view.name)).status, 400);
}

#[test]
fn splats_are_drawn_as_bodies_and_between_clip_planes() {
    let viewer = Running::start("127.0.0.1:0");
    let view = &viewer.dataset.train[0];
    let options = SolidOptions { shape: Shape::Ellipsoids { deviations: 2.0 }, least_opacity: 0.25 };
    let expected = luxel_view::solids::render(&viewer.scene, &view.camera, options).unwrap();
    let path = format!("/api/frame.exr?view={}&channels=rgb,depth", view.name);
    let served = viewer.get(&format!("{path}&splats=ellipsoids&splat_size=2&splat_opacity=0.25"));
    assert_eq!(served.body, expected.encode_exr(false, true).unwrap());
    // Nothing is nearer than the near plane, up to the size of splats; then all is as before.
    let whole = viewer.get(&path);
    let nearest = |path: &str| {
        let frame = viewer.get(path);
        let depths = frame.body[24 * 24 * 6..].chunks(4).map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap()));
        depths.fold(f32::INFINITY, f32::min)
    };
    let path_of_frame = format!("/api/frame?view={}&channels=rgb,depth", view.name);
    let near = nearest(&path_of_frame);
    assert!(nearest(&format!("{path_of_frame}&near={}", near * 1.5)) > near * 1.4);
    assert_eq!(viewer.get(&path).body, whole.body);
}

#[test]
fn a_lens_shows_what_a_photograph_does() {
    let viewer = Running::start("127.0.0.1:0");
    let camera = viewer.dataset.train[0].camera.clone();
    let address = format!("/api/frame.exr?view={}", viewer.dataset.train[0].name);
    let mut renderer = Renderer::new(&viewer.scene, Device::Cpu).unwrap();
    let aperture = Some(Aperture { diameter: 0.2, focus_distance: 2.0, blades: None });
    let photograph = Photograph { camera: camera.clone(), aperture, motion: None };
    let whole = viewer.get(&format!("{address}&aperture=0.2&focus=2&lens_samples=8"));
    let (expected, _) = renderer.photograph(&photograph, Sampling { count: Some(8), set: 0 }).unwrap();
    assert!(whole.status == 200 && whole.body == expected.encode_exr().unwrap());
    let part = viewer.get(&format!("{address}&aperture=0.2&focus=2&lens_samples=8&lens_part=1&lens_parts=4"));
    assert_eq!(part.body, renderer.photograph_part(&photograph, 8, [1, 4]).unwrap().encode_exr().unwrap());
    assert!(part.body != whole.body);
    // Coverage and depth are those of the middle of the lens.
    let layers = viewer.get(&format!("{address}&aperture=0.2&focus=2&lens_samples=8&channels=rgb,alpha,depth"));
    let plain = renderer.render_layers(&camera).unwrap();
    assert_eq!(layers.body, RadianceLayers { radiance: expected, ..plain }.encode_exr(true, true).unwrap());
    for (query, expected) in
        [("&aperture=0.2", "is missing, expected the distance in focus"), ("&aperture=0.2&focus=2&splats=centres", "blended splats")]
    {
        let answer = viewer.get(&format!("{address}{query}"));
        assert!(answer.status == 400 && answer.text().contains(expected), "{query}: {}", answer.text());
    }
}

#[test]
fn without_a_display_of_opencolorio_there_is_no_table() {
    let viewer = Running::start("127.0.0.1:0");
    assert!(viewer.json("/api/scene")["display"].is_null());
    let answer = viewer.get("/api/display");
    assert!(answer.status == 404 && answer.text().contains("no display of OpenColorIO"), "{}", answer.text());
}

#[test]
fn other_hosts_pages_and_methods_are_refused() {
    let viewer = Running::start("127.0.0.1:0");
    let with_host =
        |host: &str| viewer.raw(format!("GET /api/scene HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").as_bytes()).status;
    assert_eq!((with_host("evil.example"), with_host("localhost:1"), with_host("127.0.0.1")), (403, 200, 200));
    let from = |origin: &str| viewer.request("GET", "/api/scene", &format!("Origin: {origin}\r\n")).status;
    assert_eq!((from("http://evil.example"), from("null"), from(&format!("http://{}", viewer.address))), (403, 403, 200));
    for method in ["POST", "PUT", "DELETE", "OPTIONS", "TRACE"] {
        assert_eq!(viewer.request(method, "/api/scene", "").status, 405, "{method}");
    }
    assert_eq!(viewer.request("POST", "/api/training/stop", "").status, 404);
    assert_eq!(viewer.request("POST", "/api/training/stop", "Origin: http://evil.example\r\n").status, 403);
}

#[test]
fn an_address_for_others_asks_for_the_token() {
    let viewer = Running::start("0.0.0.0:0");
    let token = viewer.url.split("token=").nth(1).unwrap();
    assert_eq!((viewer.get("/").status, viewer.get("/api/scene").status, viewer.get("/api/events").status), (403, 403, 403));
    assert_eq!(viewer.get(&format!("/?token={}", "0".repeat(32))).status, 403);
    let page = viewer.get(&format!("/?token={token}"));
    assert!(page.status == 200 && page.head.contains(&format!("set-cookie: luxel_token={token}; path=/; httponly; samesite=strict")));
    assert_eq!(viewer.request("GET", "/api/scene", &format!("Cookie: luxel_token={token}\r\n")).status, 200);
}

#[test]
fn bad_requests_are_answered_with_what_is_wrong() {
    let viewer = Running::start("127.0.0.1:0");
    for (path, expected) in [
        ("/api/frame", "expected one of"),
        ("/api/frame?view=none", "no view"),
        ("/api/frame?view=000&channels=rgb,normal", "unknown channel"),
        ("/api/frame?view=000&size=3", "unknown parameter"),
        ("/api/frame?view=000&width=x", "expected a number"),
        ("/api/frame?view=000&width=0", "camera"),
        ("/api/frame?view=000&width=60000&height=60000", "at most"),
        ("/api/frame?view=000&edit=shine", "shine"),
        ("/api/frame?view=000&edit=where+mask(m.png,+000);+gain+2", "painted masks"),
        ("/api/frame?camera=%7B%7D", "transform_matrix"),
        ("/api/frame?camera=7", "not a JSON object"),
        ("/api/frame?view=000&scene=1", "below 1"),
        ("/api/frame?view=000&splats=cubes", "expected blended, ellipsoids or centres"),
        ("/api/frame?view=000&near=2&far=1", "near < far"),
        ("/api/probe?view=000&x=24&y=0", "outside of 24 x 24"),
        ("/api/probe?view=000&x=2", "\\\"y\\\" is missing"),
    ] {
        let response = viewer.get(path);
        let body = String::from_utf8(response.body).unwrap();
        assert!((400..500).contains(&response.status) && body.contains(expected), "{path}: {} {body}", response.status);
    }
}

#[test]
fn clients_that_never_read_and_malformed_messages_delay_nobody() {
    let viewer = Running::start("127.0.0.1:0");
    // Answers of several megabytes that nobody takes.
    let stalled: Vec<TcpStream> = (0..8)
        .map(|_| {
            let mut stream = TcpStream::connect(viewer.address).unwrap();
            let request = format!("GET /api/frame?view=000&width=1000&height=1000 HTTP/1.1\r\nHost: {}\r\n\r\n", viewer.address);
            stream.write_all(request.as_bytes()).unwrap();
            stream
        })
        .collect();
    let garbage = [
        "\0\0\0\0",
        "GET",
        "GET / HTTP/9\r\n\r\n",
        "\r\n\r\n\r\n",
        "POST / HTTP/1.1\r\nContent-Length: -1\r\n\r\n",
        "GET /%ff?%zz HTTP/1.1\r\n\r\n",
    ];
    for message in garbage.iter().cycle().take(600) {
        let mut stream = TcpStream::connect(viewer.address).unwrap();
        let _ = stream.write_all(message.as_bytes());
    }
    let long = format!("GET /{} HTTP/1.1\r\nHost: a\r\n\r\n", "a".repeat(1 << 20));
    let mut stream = TcpStream::connect(viewer.address).unwrap();
    let _ = stream.write_all(long.as_bytes());
    let start = Instant::now();
    assert_eq!(viewer.get("/api/frame?view=000").status, 200);
    assert_eq!(viewer.get("/api/scene").status, 200);
    // Not a measurement: far below the time after which stalled clients are dropped.
    assert!(start.elapsed() < Duration::from_secs(15));
    drop(stalled);
}

#[test]
fn states_are_streamed() {
    let viewer = Running::start("127.0.0.1:0");
    let mut stream = TcpStream::connect(viewer.address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    write!(stream, "GET /api/events HTTP/1.1\r\nHost: {}\r\n\r\n", viewer.address).unwrap();
    let (mut text, mut buffer) = (String::new(), [0; 4096]);
    while !text.contains("data: ") {
        let count = stream.read(&mut buffer).unwrap();
        assert!(count > 0, "{text}");
        text += std::str::from_utf8(&buffer[..count]).unwrap();
    }
    assert!(text.contains("text/event-stream") && text.contains(r#"{"version":0,"splats":300,"cameras":0,"training":null}"#), "{text}");
}

#[test]
fn splats_are_downloaded_as_they_are_and_under_edits() {
    let viewer = Running::start("127.0.0.1:0");
    let head = |path: &str| -> (Value, usize) {
        let body = viewer.get(path).body;
        let length = u32::from_le_bytes(body[..4].try_into().unwrap()) as usize;
        (serde_json::from_slice(&body[4..4 + length]).unwrap(), body.len() - 4 - length)
    };
    let (facts, half) = head("/api/splats");
    assert_eq!((&facts["splats"], &facts["colorModel"]), (&300.into(), &viewer.scene.splats.color_model.name().into()));
    assert_eq!(viewer.json("/api/scene")["download_bytes"], half);
    assert_eq!(head("/api/splats?precision=single").1, 4 * 300 * facts["rows"].as_array().unwrap().len());
    let plain = viewer.get("/api/splats").body;
    assert!(viewer.get("/api/splats?edit=").body == plain && viewer.get("/api/splats?edit=gain+2").body != plain);
    // What edits change alone, for a page that has the splats.
    let (changes, bytes) = head("/api/splats/changes?edit=gain+2");
    assert_eq!((&changes["splats"], &changes["removed"], &changes["changed"]), (&300.into(), &0.into(), &300.into()));
    assert!(bytes > 0 && bytes < half, "{bytes} of {half}");
    let (changes, bytes) = head("/api/splats/changes?edit=delete+L+%3C+p50");
    assert!((140..=150).contains(&changes["removed"].as_u64().unwrap()) && changes["changed"] == 0, "{changes}");
    assert_eq!((&changes["rows"], bytes), (&serde_json::json!([]), 40));
    assert_eq!(head("/api/splats/changes?edit=up+0,1,0").0["changed"], 0);
    for (edit, words) in [("delete+all", "nothing would be left"), ("shine", "shine"), ("where+mask(%22a.png%22,%22b%22);gain+2", "mask")] {
        let response = viewer.get(&format!("/api/splats/changes?edit={edit}"));
        let text = String::from_utf8_lossy(&response.body).into_owned();
        assert!((400..500).contains(&response.status) && text.contains(words), "{edit}: {} {text}", response.status);
    }
    for query in ["edit=shine", "precision=double", "edit=gain", "size=3"] {
        let response = viewer.get(&format!("/api/splats?{query}"));
        assert!(response.status == 400 && String::from_utf8_lossy(&response.body).contains("error"), "{query}: {}", response.status);
    }
}
