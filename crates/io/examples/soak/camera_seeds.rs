//! Small valid files of cameras that other programs write.

use crate::seeds::{self, array};

pub(crate) fn realityscan_table() -> Vec<Vec<u8>> {
    vec![
        b"#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2\na.jpg,1,2,3,90,60,0,18,0.01,-0.02,-0.1,0.02,0.003,0,0.001,-0.002\n"
            .to_vec(),
    ]
}

pub(crate) fn realityscan_xmp() -> Vec<Vec<u8>> {
    let xmp = r#"<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description xcr:DistortionModel="brown3" xcr:FocalLength35mm="18" xcr:PrincipalPointU="0.01" xcr:PrincipalPointV="-0.02"
 xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#"><xcr:Rotation>0 0 -1 0 -1 0 -1 0 0</xcr:Rotation><xcr:Position>10 20 3</xcr:Position>
<xcr:DistortionCoeficients>-0.1 0.02 0.003 0 0.001 -0.002</xcr:DistortionCoeficients></rdf:Description></rdf:RDF></x:xmpmeta>"#;
    vec![xmp.as_bytes().to_vec()]
}

pub(crate) fn metashape() -> Vec<Vec<u8>> {
    let xml = r#"<document version="2.0.0"><chunk><sensors><sensor id="0" type="fisheye"><resolution width="640" height="480"/>
<calibration type="fisheye" class="adjusted"><f>200</f><cx>1</cx><k1>-0.05</k1><p1>0.001</p1><b2>1</b2></calibration></sensor></sensors>
<components><component id="0"><transform><rotation>1 0 0 0 1 0 0 0 1</rotation><translation>1 2 3</translation><scale>2</scale></transform></component></components>
<cameras><camera id="0" sensor_id="0" component_id="0" label="a"><transform>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</transform></camera><camera id="1" label="b"/></cameras>
</chunk></document>"#;
    vec![xml.as_bytes().to_vec()]
}

pub(crate) fn polycam() -> Vec<Vec<u8>> {
    let json = r#"{"fx": 50.5, "fy": 51, "cx": 20, "cy": 14.5, "width": 40, "height": 30, "t_00": 0, "t_01": 0, "t_02": 1, "t_03": 1,
"t_10": 0, "t_11": 1, "t_12": 0, "t_13": 2, "t_20": -1, "t_21": 0, "t_22": 0, "t_23": 3}"#;
    vec![json.as_bytes().to_vec()]
}

pub(crate) fn record3d() -> Vec<Vec<u8>> {
    let json = r#"{"w": 40, "h": 30, "K": [50, 0, 0, 0, 51, 0, 20, 15, 1], "poses": [[0, 0, 0, 1, 1, 2, 3], [0, 1, 0, 0, 1, 2, 4]],
"perFrameIntrinsicCoeffs": [[50, 51, 20, 15], [50, 51, 20, 15]]}"#;
    vec![json.as_bytes().to_vec()]
}

pub(crate) fn poses_bounds() -> Vec<Vec<u8>> {
    let row = [0.0, 1.0, 0.0, 0.5, 8.0, -1.0, 0.0, 0.0, 0.0, 16.0, 0.0, 0.0, 1.0, 4.0, 20.0, 1.0, 9.0f64];
    let samples: Vec<u8> = [row, row].concat().into_iter().flat_map(f64::to_le_bytes).collect();
    vec![array("{'descr': '<f8', 'fortran_order': False, 'shape': (2, 17), }", &samples)]
}

pub(crate) fn usd() -> Vec<Vec<u8>> {
    let stage = r#"#usda 1.0
(
    metersPerUnit = 0.01
    upAxis = "Y"
)
def Xform "World"
{
    double3 xformOp:translate = (1, 2, 0)
    float3 xformOp:rotateXYZ = (0, 90, 0)
    uniform token[] xformOpOrder = ["xformOp:translate", "!invert!xformOp:rotateXYZ"]
    def Camera "Shot"
    {
        float focalLength.timeSamples = { 1: 20, 2: 30 }
        float horizontalAperture = 16
        quatf xformOp:orient = (1, 0, 0, 0)
        matrix4d xformOp:transform.timeSamples = { 1: ((1,0,0,0),(0,1,0,0),(0,0,1,0),(-3,0,0,1)), 3: None }
        uniform token[] xformOpOrder = ["!resetXformStack!", "xformOp:orient", "xformOp:transform"]
    }
}
"#;
    vec![stage.as_bytes().to_vec()]
}

pub(crate) fn depth() -> Vec<Vec<u8>> {
    let samples: Vec<u8> = (0..12u8).flat_map(|v| f32::from(v).to_le_bytes()).collect();
    let pfm = [&b"Pf\n4 3\n-1.0\n"[..], &samples].concat();
    let npy = array("{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4), }", &samples);
    [vec![pfm, npy, seeds::grey16()], seeds::exr()].concat()
}
