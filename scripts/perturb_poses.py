#!/usr/bin/env python3
"""Makes a data set with wrong camera poses from one with right ones.

    scripts/perturb_poses.py DATASET OUTPUT --px 2 [--focal 0.005] [--seed 1] [--test]

Reads DATASET/transforms.json. OUTPUT gets a transforms.json whose training poses are turned and moved at random, by rotations and
translations that each move the image of the scene by PX / sqrt(2) pixels on average, and whose focal lengths are multiplied by 1 + FOCAL.
With --test the test poses are moved, too. Images, points and split are linked. Needed: numpy. The distance of the scene is that of
the point nearest to all viewing axes.
"""

import argparse
import json
import pathlib

import numpy as np

LINKED = ("images", "sparse", "masks", "split.json", "LICENSES.txt")
FOCAL_KEYS = ("fl_x", "fl_y")


def rotation(vector):
    """Returns the matrix of a rotation vector, radians."""
    angle = np.linalg.norm(vector)
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def common_point(poses):
    """Returns the point nearest to all viewing axes."""
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for pose in poses:
        axis = pose[:3, 2] / np.linalg.norm(pose[:3, 2])
        across = np.eye(3) - np.outer(axis, axis)
        normal += across
        right += across @ pose[:3, 3]
    return np.linalg.lstsq(normal, right, rcond=None)[0]


def perturbed(pose, px, focal_px, depth, random):
    """Returns a camera-to-world matrix turned and moved in its own axes."""
    # A rotation vector or a translation has two components that move the image much.
    angle, shift = random.normal(size=(2, 3)) * px / focal_px / 2
    moved = pose.copy()
    moved[:3, 3] += pose[:3, :3] @ shift * depth
    moved[:3, :3] = pose[:3, :3] @ rotation(angle)
    return moved


def main():
    """Writes the data set."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=pathlib.Path)
    parser.add_argument("output", type=pathlib.Path)
    parser.add_argument("--px", type=float, default=0.0, help="motion of the images, pixels of the full resolution")
    parser.add_argument("--focal", type=float, default=0.0, help="relative error of the focal lengths")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--test", action="store_true", help="move the test poses, too")
    args = parser.parse_args()
    scene = json.loads((args.dataset / "transforms.json").read_text())
    split_file = args.dataset / "split.json"
    test = set(json.loads(split_file.read_text()).get("test", [])) if split_file.is_file() else set()
    poses = [np.array(frame["transform_matrix"]) for frame in scene["frames"]]
    point = common_point(poses)
    random = np.random.default_rng(args.seed)
    for frame, pose in zip(scene["frames"], poses):
        focal_px = frame.get("fl_x", scene.get("fl_x"))
        depth = np.linalg.norm(point - pose[:3, 3])
        moved = perturbed(pose, args.px, focal_px, depth, random)
        if args.test or frame["file_path"] not in test:
            frame["transform_matrix"] = moved.tolist()
    for lens in [scene, *scene["frames"]]:
        lens.pop("camera_angle_x", None)
        lens.pop("camera_angle_y", None)
        for key in FOCAL_KEYS:
            if key in lens:
                lens[key] *= 1 + args.focal
    args.output.mkdir(parents=True, exist_ok=False)
    (args.output / "transforms.json").write_text(json.dumps(scene, indent=1) + "\n")
    for name in LINKED:
        source = args.dataset / name
        if source.exists():
            (args.output / name).symlink_to(source.resolve())


if __name__ == "__main__":
    main()
