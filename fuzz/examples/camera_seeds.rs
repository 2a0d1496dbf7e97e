//! Writes small valid files of cameras, as other programs export them, and of depth and plates to
//! the corpora. `cargo run --release --example camera_seeds`.

use std::path::PathBuf;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    write("metashape", "frame.xml", METASHAPE.as_bytes())?;
    write("metashape", "spherical.xml", METASHAPE.replace("\"frame\"", "\"spherical\"").as_bytes())?;
    write("realityscan_table", "two.csv", REALITYSCAN_TABLE.as_bytes())?;
    write("realityscan_xmp", "brown.xmp", REALITYSCAN_XMP.as_bytes())?;
    write("polycam", "1000.json", POLYCAM.as_bytes())?;
    write("record3d", "metadata.json", RECORD3D.as_bytes())?;
    write("poses_bounds", "two.npy", &poses_bounds())?;
    write("usd_cameras", "cameras.usda", include_bytes!("../../crates/io/src/usd/tests/cameras.usda"))?;
    write("usd_cameras", "cameras.usdc", &unhex(include_str!("../../crates/io/src/usd/tests/cameras.hex")))?;
    for (name, text) in [("cameras", COLMAP_CAMERAS), ("distorted", COLMAP_DISTORTED)] {
        write("colmap_txt", name, [text, COLMAP_IMAGES, COLMAP_POINTS].join("\n@@\n").as_bytes())?;
    }
    write("colmap_rigs", "text", [COLMAP_RIGS, COLMAP_FRAMES].join("\n@@\n").as_bytes())?;
    write("depth_map", "little.pfm", &[&b"Pf\n2 2\n-1.0\n"[..], &[1.0f32, 2.0, 0.0, 4.0].map(f32::to_le_bytes).concat()].concat())?;
    write("depth_map", "two.npy", &npy("(2, 2)", "<f4", &[1.0f32, 2.0, 0.0, 4.0].map(f32::to_le_bytes).concat()))?;
    for curve in 0..12u8 {
        write("image_plate", &format!("{curve}.png"), &[&[curve][..], &luxel_io::encode_png(3, 2, &[90; 18])?].concat())?;
    }
    Ok(())
}

fn write(target: &str, file: &str, bytes: &[u8]) -> std::io::Result<()> {
    let folder = PathBuf::from("corpus").join(target);
    std::fs::create_dir_all(&folder)?;
    std::fs::write(folder.join(file), bytes)
}

fn unhex(text: &str) -> Vec<u8> {
    let digits: Vec<u8> = text.chars().filter_map(|c| c.to_digit(16)).map(|digit| digit as u8).collect();
    digits.chunks_exact(2).map(|pair| pair[0] << 4 | pair[1]).collect()
}

fn npy(shape: &str, kind: &str, samples: &[u8]) -> Vec<u8> {
    let header = format!("{:<117}\n", format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}"));
    [&b"\x93NUMPY\x01\x00"[..], &(header.len() as u16).to_le_bytes(), header.as_bytes(), samples].concat()
}

/// Returns two rows of `poses_bounds.npy`.
fn poses_bounds() -> Vec<u8> {
    let row = |x: f64| [0.0, 1.0, 0.0, x, 8.0, -1.0, 0.0, 0.0, 0.0, 16.0, 0.0, 0.0, 1.0, 4.0, 20.0, 1.0, 9.0];
    npy("(2, 17)", "<f8", &[row(0.5), row(-0.5)].concat().into_iter().flat_map(f64::to_le_bytes).collect::<Vec<u8>>())
}

const METASHAPE: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0"><chunk label="a" enabled="true">
<sensors next_id="1"><sensor id="0" label="b" type="frame"><resolution width="64" height="48"/>
<calibration type="frame" class="adjusted"><resolution width="64" height="48"/><f>60.5</f><cx>0.5</cx><cy>-1</cy><k1>0.01</k1><k2>-0.002</k2><p1>1e-4</p1></calibration></sensor></sensors>
<components next_id="1"><component id="0"><transform><rotation>1 0 0 0 1 0 0 0 1</rotation><translation>1 2 3</translation><scale>2</scale></transform></component></components>
<cameras next_id="2"><camera id="0" sensor_id="0" component_id="0" label="a.jpg"><transform>1 0 0 0.5 0 1 0 0 0 0 1 0 0 0 0 1</transform></camera>
<camera id="1" sensor_id="0" label="b.jpg"/></cameras></chunk></document>
"#;

const REALITYSCAN_TABLE: &str = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2
a.jpg,1.5,-2,0.25,30,80,-1.5,28.5,0.01,-0.02,0.05,-0.01,0,0,1e-4,0
b.jpg,0,0,0,0,0,0,35,0,0,0,0,0,0,0,0
";

const REALITYSCAN_XMP: &str = r#"<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#" xcr:Version="3" xcr:DistortionModel="brown3" xcr:FocalLength35mm="28"
 xcr:Skew="0" xcr:AspectRatio="1" xcr:PrincipalPointU="0.01" xcr:PrincipalPointV="-0.01">
<xcr:Rotation>1 0 0 0 1 0 0 0 1</xcr:Rotation><xcr:Position>0.5 1 -2</xcr:Position><xcr:DistortionCoeficients>0.01 0 0 0 0 0</xcr:DistortionCoeficients>
</rdf:Description></rdf:RDF></x:xmpmeta>
"#;

const POLYCAM: &str = r#"{"fx": 60.5, "fy": 60.5, "cx": 32, "cy": 24, "width": 64, "height": 48, "blur_score": 120.5, "timestamp": 1000,
"t_00": 1, "t_01": 0, "t_02": 0, "t_03": 0.5, "t_10": 0, "t_11": 1, "t_12": 0, "t_13": 1, "t_20": 0, "t_21": 0, "t_22": 1, "t_23": -2}"#;

const RECORD3D: &str = r#"{"w": 64, "h": 48, "fps": 30, "K": [60.5, 0, 0, 0, 60.5, 0, 32, 24, 1], "poses": [[0, 0, 0, 1, 0.5, 1, -2], [0, 0.7071068, 0, 0.7071068, 0, 0, 0]],
"perFrameIntrinsicCoeffs": [[60.5, 60.5, 32, 24], [61, 61, 32, 24]]}"#;

const COLMAP_CAMERAS: &str = "1 PINHOLE 64 48 60 60 32 24\n2 EQUIRECTANGULAR 64 32\n";
const COLMAP_DISTORTED: &str = "1 OPENCV 64 48 60 60 32 24 0.1 0.01 0 0\n2 OPENCV_FISHEYE 64 48 30 30 32 24 0.1 0 0 0\n3 FULL_OPENCV 64 48 60 60 32 24 .1 0 0 0 0 0 0 0\n";
const COLMAP_IMAGES: &str = "1 1 0 0 0 0 0 0 1 a.jpg\n3.5 4.5 1 7 8 -1\n2 0.7071068 0 0.7071068 0 1 2 3 2 b.jpg\n\n";
const COLMAP_POINTS: &str = "1 0.5 0.25 4 200 100 50 0.5 1 0\n";
const COLMAP_RIGS: &str = "1 2 CAMERA 1 CAMERA 2 1 1 0 0 0 0.5 0 0\n";
const COLMAP_FRAMES: &str = "1 1 1 0 0 0 0 0 0 2 CAMERA 1 1 CAMERA 2 2\n";
