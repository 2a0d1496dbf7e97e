"""Opens every export of a scene with independent readers, and compares what they hold, and renders of it, with Luxel's own.

    python3 -m venv venv && venv/bin/pip install usd-core plyfile gsply OpenEXR pygltflib numpy
    npm install gltf-validator @playcanvas/splat-transform @adobe/spz
    venv/bin/python examples/check_exports.py RUN OUT --luxel target/release/luxel --node-modules node_modules

RUN is the folder of a trained run. What a reader found is written as a plain PLY by plyfile, and rendered by Luxel on the run's held-out
views as any foreign file would be. The table goes to OUT/table.md.
"""

import argparse
import json
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import OpenEXR
from plyfile import PlyData, PlyElement

C0 = 0.28209479177387814


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--luxel", default="luxel")
    parser.add_argument("--node-modules", type=Path, default=Path("node_modules"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    check = Check(args)
    rows = [row for job in check.jobs() for row in check.run(*job)]
    head = ["file", "bytes", "bake", "reader", "what it showed", "largest difference of a value", "image against Luxel's"]
    table = [head, ["---"] * len(head), *rows]
    text = "\n".join("| " + " | ".join(map(str, row)) + " |" for row in table) + "\n"
    (args.out / "table.md").write_text(text)
    print(text)


class Check:
    def __init__(self, args):
        self.args = args
        self.renders = {}

    def luxel(self, *words):
        done = subprocess.run([self.args.luxel, *map(str, words)], capture_output=True, text=True)
        if done.returncode != 0:
            sys.exit(f"luxel {words}: {done.stderr}")
        return done.stdout

    def jobs(self):
        """File, options, bake, readers."""
        linear = ["--bake", "linear", "--output-color-space", "linear-rec709"]
        return [
            ("exact.ply", [], "display", [self.plyfile, self.gsply, self.splat_transform]),
            ("display.ply", ["--bake", "display"], "display", [self.plyfile, self.gsply, self.splat_transform]),
            ("linear.ply", linear, "linear", [self.plyfile, self.gsply, self.splat_transform]),
            ("linear.usda", linear, "linear", [self.usd]),
            ("acescg.usda", ["--bake", "linear", "--output-color-space", "acescg"], "acescg", [self.usd]),
            ("display.usda", ["--bake", "display"], "display", [self.usd]),
            ("exact.glb", [], "display", [self.pygltflib]),
            ("linear.glb", linear, "linear", [self.pygltflib]),
            ("v2.spz", ["--spz-version", "2"], "display", [self.splat_transform, self.gsply, self.adobe_spz]),
            ("v3.spz", ["--spz-version", "3"], "display", [self.splat_transform, self.gsply, self.adobe_spz]),
            ("v4.spz", ["--spz-version", "4"], "display", [self.splat_transform, self.gsply, self.adobe_spz]),
        ]

    def run(self, name, options, bake, readers):
        path = self.args.out / name
        said = self.luxel("export", self.args.run, "-o", path, "--overwrite", "--up", "as-is", "--threads", 2, *options)
        (self.args.out / f"{name}.txt").write_text(said)
        own = self.own(path, bake)
        reference = self.render(own, f"{name}-luxel")
        for reader in readers:
            try:
                label, showed, table = reader(path)
            except Exception as error:  # A reader that fails is a finding.
                yield [name, path.stat().st_size, bake, reader.__name__, f"failed: {str(error)[:160]}", "", ""]
                continue
            target = self.args.out / f"{name}-{reader.__name__}.ply"
            write_ply(target, table)
            found = self.render(target, f"{name}-{reader.__name__}")
            yield [name, path.stat().st_size, bake, label, showed, self.worst(own, table), compare(reference, found, bake)]

    def own(self, path, bake):
        """The plain PLY of the same bake, straight from Luxel."""
        space = ["--output-color-space", "acescg"] if bake == "acescg" else ["--output-color-space", "linear-rec709"]
        options = ["--bake", "linear", *space] if bake != "display" else ["--bake", "display"]
        target = self.args.out / f"own-{bake}.ply"
        if not target.exists():
            self.luxel("export", self.args.run, "-o", target, "--up", "as-is", "--threads", 2, *options)
            plain = read_ply(target)
            write_ply(target, plain)
        return target

    def render(self, path, name):
        folder = self.args.out / "renders" / name
        if not folder.exists():
            data = json.loads(json.dumps(self.dataset()))
            self.luxel("render", path, "--data", data, "--split", "test", "--frames", "0-3", "-o", folder, "--exr-type", "float", "--threads", 2)
        return [read_exr(file) for file in sorted(folder.glob("*.exr"))]

    def dataset(self):
        for line in (self.args.run / "config.toml").read_text().splitlines():
            if line.startswith("dataset"):
                return line.split("=", 1)[1].strip().strip('"')
        sys.exit("no data set in config.toml")

    def worst(self, own, table):
        expected = read_ply(own)
        if len(expected["opacity"]) != len(table["opacity"]):
            return f"{len(table['opacity'])} splats, expected {len(expected['opacity'])}"
        parts = []
        for name in ["position", "sh", "opacity", "scale"]:
            a, b = expected[name], table[name]
            if name == "opacity":
                # An opacity of 1 has no finite logit.
                a, b = np.clip(a, -14, 14), np.clip(b, -14, 14)
            if a.shape != b.shape:
                return f"{name}: {b.shape}, expected {a.shape}"
            parts.append(f"{name} {np.abs(a - b).max():.1e}")
        return ", ".join(parts)

    def plyfile(self, path):
        table = read_ply(path)
        return f"plyfile {version('plyfile')}", f"{len(table['opacity'])} splats, degree {degree(table)}", table

    def gsply(self, path):
        import gsply

        if path.suffix == ".spz":
            data = gsply.read_spz(str(path))
            turned = True
        else:
            data = gsply.plyread(str(path))
            turned = False
        n = len(data.means)
        rest = np.asarray(data.shN, dtype=np.float64).reshape(n, -1, 3) if data.shN is not None and np.size(data.shN) else np.zeros((n, 0, 3))
        sh = np.concatenate([np.asarray(data.sh0, dtype=np.float64).reshape(n, 1, 3), rest], axis=1)
        table = dict(position=np.asarray(data.means, float), sh=sh, opacity=np.asarray(data.opacities, float).reshape(-1),
                     scale=np.asarray(data.scales, float), rotation=np.asarray(data.quats, float))
        if turned:
            half_turn(table)
        return f"gsply {version('gsply')}", f"{n} splats, degree {degree(table)}", table

    def splat_transform(self, path):
        tool = self.args.node_modules / "@playcanvas/splat-transform/bin/cli.mjs"
        target = self.args.out / f"{path.name}-converted.ply"
        done = subprocess.run(["node", tool, "-w", path, target], capture_output=True, text=True)
        if done.returncode != 0:
            raise RuntimeError((done.stderr or done.stdout).strip().splitlines()[-1])
        package = json.loads((self.args.node_modules / "@playcanvas/splat-transform/package.json").read_text())
        table = read_ply(target)
        return f"splat-transform {package['version']}", f"{len(table['opacity'])} splats, degree {degree(table)}", table

    def adobe_spz(self, path):
        """Niantic's reference, as Adobe builds it for JavaScript."""
        target = self.args.out / f"{path.name}.floats"
        package = self.args.node_modules / "@adobe/spz"
        script = (f"import load from {json.dumps(str((package / 'dist/spz.js').resolve()))};import fs from 'fs';const m=await load();"
                  "const [from,to]=process.argv.slice(1);"
                  "const c=m.loadSpzFromBuffer(new Uint8Array(fs.readFileSync(from)),{to:m.CoordinateSystem.RDF});"
                  "const parts=[c.positions,c.scales,c.rotations,c.alphas,c.colors,c.sh].map(a=>Float32Array.from(a));"
                  "fs.writeFileSync(to,Buffer.concat(parts.map(a=>Buffer.from(a.buffer))));console.log(parts.map(a=>a.length).join(' '))")
        done = subprocess.run(["node", "--input-type=module", "-e", script, path, target], capture_output=True, text=True)
        if done.returncode != 0:
            raise RuntimeError((done.stderr or done.stdout).strip().splitlines()[-1])
        # The library talks on the same channel.
        ends = np.cumsum([int(word) for word in done.stdout.strip().splitlines()[-1].split()])
        position, scale, rotation, alpha, color, rest = np.split(np.fromfile(target, "<f4").astype(np.float64), ends[:-1])
        n = len(alpha)
        sh = np.concatenate([color.reshape(n, 1, 3), rest.reshape(n, -1, 3)], axis=1)
        table = dict(position=position.reshape(n, 3), sh=sh, opacity=alpha, scale=scale.reshape(n, 3),
                     rotation=rotation.reshape(n, 4)[:, [3, 0, 1, 2]])
        release = json.loads((package / "package.json").read_text())["version"]
        return f"@adobe/spz {release}", f"{n} splats, degree {degree(table)}", table

    def usd(self, path):
        from pxr import Usd, UsdGeom, UsdVol

        stage = Usd.Stage.Open(str(path))
        prim = UsdVol.ParticleField3DGaussianSplat(stage.GetDefaultPrim())
        assert prim, "no ParticleField3DGaussianSplat"
        space = Usd.ColorSpaceAPI(prim.GetPrim()).GetColorSpaceNameAttr().Get()
        positions = np.array(prim.GetPositionsAttr().Get(), dtype=np.float64)
        n, level = len(positions), prim.GetRadianceSphericalHarmonicsDegreeAttr().Get()
        sh = np.array(prim.GetRadianceSphericalHarmonicsCoefficientsAttr().Get(), dtype=np.float64).reshape(n, (level + 1) ** 2, 3)
        opacity = np.clip(np.array(prim.GetOpacitiesAttr().Get(), dtype=np.float64), 1e-7, 1 - 1e-7)
        rotation = np.array([[q.GetReal(), *q.GetImaginary()] for q in prim.GetOrientationsAttr().Get()])
        table = dict(position=positions, sh=sh, opacity=np.log(opacity / (1 - opacity)),
                     scale=np.log(np.array(prim.GetScalesAttr().Get(), dtype=np.float64)), rotation=rotation)
        showed = f"{n} splats, degree {level}, {space}, up {UsdGeom.GetStageUpAxis(stage)}, {usd_problems(stage)}"
        return f"usd-core {version('usd-core')}", showed, table

    def pygltflib(self, path):
        from pygltflib import GLTF2

        gltf = GLTF2().load(str(path))
        blob = gltf.binary_blob()
        primitive = gltf.meshes[0].primitives[0]
        attributes = vars(primitive.attributes)

        def read(name):
            accessor = gltf.accessors[attributes[name]]
            view = gltf.bufferViews[accessor.bufferView]
            assert accessor.componentType == 5126, name
            width = dict(SCALAR=1, VEC3=3, VEC4=4)[accessor.type]
            values = np.frombuffer(blob, "<f4", accessor.count * width, view.byteOffset).astype(np.float64)
            return values.reshape(accessor.count, width)

        khr = "KHR_gaussian_splatting"
        planes, level = [], 0
        while f"{khr}:SH_DEGREE_{level}_COEF_0" in attributes:
            planes += [read(f"{khr}:SH_DEGREE_{level}_COEF_{n}") for n in range(2 * level + 1)]
            level += 1
        opacity = np.clip(read(f"{khr}:OPACITY").reshape(-1), 1e-7, 1 - 1e-7)
        rotation = read(f"{khr}:ROTATION")[:, [3, 0, 1, 2]]
        table = dict(position=read("POSITION"), sh=np.stack(planes, axis=1), opacity=np.log(opacity / (1 - opacity)),
                     scale=np.log(read(f"{khr}:SCALE")), rotation=rotation)
        extension = primitive.extensions[khr]
        own = ", our extension" if extension.get("extensions") else ""
        showed = f"{len(opacity)} splats, degree {level - 1}, {extension['colorSpace']}{own}; {self.gltf_validator(path)}"
        return f"pygltflib {version('pygltflib')}, gltf-validator", showed, table

    def gltf_validator(self, path):
        script = ("const v=require('gltf-validator');const fs=require('fs');"
                  "v.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1]))).then(r=>console.log(JSON.stringify(r.issues)))")
        done = subprocess.run(["node", "-e", script, str(path.resolve())], capture_output=True, text=True, cwd=self.args.node_modules.parent)
        issues = json.loads(done.stdout)
        (self.args.out / f"{path.name}-validator.json").write_text(json.dumps(issues, indent=1))
        codes = sorted({message["code"] for message in issues["messages"]})
        return f"{issues['numErrors']} errors, {issues['numWarnings']} warnings ({', '.join(codes)})"


def usd_problems(stage):
    from pxr import UsdValidation

    context = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators())
    errors = [str(error.GetName()) for error in context.Validate(stage)]
    return f"validators: {', '.join(errors) if errors else 'nothing found'}"


def half_turn(table):
    """From SPZ's axes, which gsply leaves as they are, to PLY's: right, up, back to right, down, forward."""
    table["position"] = table["position"] * [1, -1, -1]
    w, x, y, z = table["rotation"].T
    table["rotation"] = np.stack([-x, w, -z, y], axis=1)
    signs = np.array([1, -1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1])
    table["sh"] = table["sh"] * signs[:table["sh"].shape[1], None]


def degree(table):
    return int(round(table["sh"].shape[1] ** 0.5)) - 1


def read_ply(path):
    vertex = PlyData.read(str(path))["vertex"]
    stack = lambda *names: np.stack([np.asarray(vertex[name], dtype=np.float64) for name in names], axis=1)
    rest = sum(p.name.startswith("f_rest_") for p in vertex.properties)
    dc = stack("f_dc_0", "f_dc_1", "f_dc_2")[:, None, :]
    n = len(dc)
    higher = stack(*[f"f_rest_{i}" for i in range(rest)]).reshape(n, 3, rest // 3).transpose(0, 2, 1) if rest else np.zeros((n, 0, 3))
    return dict(position=stack("x", "y", "z"), sh=np.concatenate([dc, higher], axis=1), opacity=np.asarray(vertex["opacity"], dtype=np.float64),
                scale=stack("scale_0", "scale_1", "scale_2"), rotation=stack("rot_0", "rot_1", "rot_2", "rot_3"))


def write_ply(path, table):
    n, k = table["sh"].shape[:2]
    columns = dict(zip("xyz", table["position"].T))
    columns |= {f"f_dc_{c}": table["sh"][:, 0, c] for c in range(3)}
    columns |= {f"f_rest_{c * (k - 1) + m}": table["sh"][:, m + 1, c] for c in range(3) for m in range(k - 1)}
    columns |= {"opacity": np.clip(table["opacity"], -14, 14)}
    columns |= {f"scale_{i}": table["scale"][:, i] for i in range(3)}
    columns |= {f"rot_{i}": table["rotation"][:, i] for i in range(4)}
    rows = np.empty(n, dtype=[(name, "f4") for name in columns])
    for name, values in columns.items():
        rows[name] = values
    PlyData([PlyElement.describe(rows, "vertex")]).write(str(path))


def read_exr(path):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        return np.stack([channels[name].pixels for name in "RGB"], axis=-1).astype(np.float64)


def compare(reference, found, bake):
    a, b = np.concatenate([r.ravel() for r in reference]), np.concatenate([f.ravel() for f in found])
    if bake == "display":
        a, b = np.clip(a, 0, 1), np.clip(b, 0, 1)
        mse = np.mean((a - b) ** 2)
        return f"{10 * np.log10(1 / mse):.1f} dB" if mse > 0 else "equal"
    return f"relative {np.abs(a - b).sum() / a.sum():.1e}"


if __name__ == "__main__":
    main()
