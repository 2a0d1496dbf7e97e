#!/usr/bin/env python3
"""Compares proxy meshes with the surfaces of path-traced scenes: docs/src/notebook/mesh-truth.md.

    scripts/mesh_truth.py points loft|yard|study DATA points.npz    # of the scenes of path_traced_scenes.py
    scripts/mesh_truth.py points SCENE.xml DATA points.npz          # of a scene of Mitsuba whose y is up, in data whose z is up
    scripts/mesh_truth.py measure points.npz MESH.ply...

DATA is the data set, of whose training and test views random pixels are traced; 20,000 points in all. `measure` prints the parts
within 1 % of the diagonal of the points' box. Needs numpy; `points` needs mitsuba (see path_traced_scenes.py), `measure` trimesh
and scipy. Meshes come from `luxel mesh RUN -o MESH.ply`.
"""

import argparse
import json
import pathlib
import tempfile
import xml.etree.ElementTree

import numpy as np

POINTS = 20_000
SAMPLES = 200_000
# Surfaces that splats do not lie on, by words of the scenes' materials.
MIRRORS = ("conductor", "dielectric", "Mirror", "Glass", "Stainless", "Metal")


def items_of(mi, scene, folder):
    """Mitsuba's dictionary of a scene's shapes, and the names of mirrors and glass."""
    if not scene.endswith(".xml"):
        import path_traced_scenes as traced

        made = traced.Scene(mi)
        traced.SCENES[scene][0](made, folder)
        is_mirror = lambda item: isinstance(item, dict) and any(word in str(item.get("bsdf", "")) for word in MIRRORS)  # noqa: E731
        return made.items, {name for name, item in made.items.items() if is_mirror(item)}
    path, items, mirrors = pathlib.Path(scene), {"type": "scene"}, set()
    z_up = mi.ScalarTransform4f([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    for i, shape in enumerate(xml.etree.ElementTree.parse(path).getroot().findall("shape")):
        file = path.parent / shape.find("string").get("value") if shape.get("type") == "obj" else None
        if file is None or not file.exists():
            continue
        items[f"shape{i}"] = {"type": "obj", "filename": str(file), "to_world": z_up}
        reference = shape.find("ref")
        if reference is not None and any(word in reference.get("id") for word in MIRRORS):
            mirrors.add(f"shape{i}")
    return items, mirrors


def cameras_of(data):
    """Poses and lens of all views."""
    for split in ("train", "test"):
        text = json.loads((data / f"transforms_{split}.json").read_text())
        lens = text if "fl_x" in text else json.loads((data / "transforms.json").read_text())
        for frame in text["frames"]:
            yield np.array(frame["transform_matrix"]), lens


def points(scene, data, out):
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    cameras, rng = list(cameras_of(data)), np.random.default_rng(1)
    count, found, on_mirror = -(-POINTS // len(cameras)), [], []
    with tempfile.TemporaryDirectory() as folder:
        items, mirrors = items_of(mi, scene, folder)
        world = mi.load_dict(items)
        mirror_shapes = [shape for shape in world.shapes() if shape.id() in mirrors]
        for pose, lens in cameras:
            x, y = rng.random((2, count)) * [[lens["w"]], [lens["h"]]]
            ray = np.stack([(x - lens["cx"]) / lens["fl_x"], (lens["cy"] - y) / lens["fl_y"], -np.ones(count)])
            ray = pose[:3, :3] @ ray / np.linalg.norm(ray, axis=0)
            eye = np.repeat(pose[:3, 3:], count, axis=1)
            hit = world.ray_intersect(mi.Ray3f(mi.Point3f(eye.astype(np.float32)), mi.Vector3f(ray.astype(np.float32))))
            is_hit = np.array(hit.is_valid())
            is_mirror = np.zeros(count, bool)
            for shape in mirror_shapes:
                is_mirror |= np.array(hit.shape == mi.ShapePtr(shape))
            found.append(np.array(hit.p).reshape(3, count).T[is_hit])
            on_mirror.append(is_mirror[is_hit])
    np.savez(out, points=np.concatenate(found), mirror=np.concatenate(on_mirror))


def measure(path, meshes, within):
    import trimesh
    from scipy.spatial import cKDTree

    truth = np.load(path)
    everything = truth["points"]
    mirror = truth["mirror"] if "mirror" in truth else np.zeros(len(everything), bool)
    near = np.linalg.norm(everything, axis=1) < within
    everything, mirror = everything[near], mirror[near]
    surface = everything[~mirror]
    near = 0.01 * np.linalg.norm(np.ptp(surface, axis=0))
    for mesh in meshes:
        samples, _ = trimesh.sample.sample_surface(trimesh.load(mesh, process=False), SAMPLES, seed=0)
        samples = samples[((samples > surface.min(0) - 0.6 * near) & (samples < surface.max(0) + 0.6 * near)).all(1)]
        to_surface, nearest = cKDTree(everything).query(samples)
        to_surface = to_surface[~mirror[nearest]]
        to_mesh, _ = cKDTree(samples).query(surface)
        right, there = (to_surface < near).mean(), (to_mesh < near).mean()
        score = 2 * right * there / (right + there)
        print(f"{mesh}: {right:.3f} right, {there:.3f} there, F {score:.3f}; medians {np.median(to_surface):.4f} {np.median(to_mesh):.4f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="what", required=True)
    command = commands.add_parser("points")
    command.add_argument("scene")
    command.add_argument("data", type=pathlib.Path)
    command.add_argument("out", type=pathlib.Path)
    command = commands.add_parser("measure")
    command.add_argument("points", type=pathlib.Path)
    command.add_argument("meshes", nargs="+")
    command.add_argument("--within", type=float, default=np.inf, help="points farther from the origin are left out")
    given = parser.parse_args()
    if given.what == "points":
        points(given.scene, given.data, given.out)
    else:
        measure(given.points, given.meshes, given.within)


if __name__ == "__main__":
    main()
