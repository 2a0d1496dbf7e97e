"""`luxel.torch` against a dense compositor in float64, whose gradients are torch's own."""

from __future__ import annotations

import math
import os
import subprocess
import sys

import numpy as np

import pytest

torch = pytest.importorskip("torch")

import luxel  # noqa: E402
from luxel.torch import lcd_radiance, log_sh_radiance, rasterization, sh_radiance, spatial_order  # noqa: E402

NAMES = ("means", "quats", "scales", "opacities", "colors", "viewmats", "backgrounds")
# Float32 rounds each of some hundred terms of a sum; tolerances are relative to the largest number.
IMAGE_TOLERANCE, GRADIENT_TOLERANCE = 5e-6, 5e-5


def scene(seed, *, n=25, c=2, d=3, size=(23, 17), per_camera=False):
    """Returns the tensors of a random scene in front of cameras, with opacities 0 and 1."""
    g = torch.Generator().manual_seed(seed)
    normal = lambda *shape: torch.randn(*shape, generator=g)  # noqa: E731
    uniform = lambda *shape: torch.rand(*shape, generator=g)  # noqa: E731
    width, height = size
    viewmats = torch.eye(4).repeat(c, 1, 1)
    for camera in range(c):
        turn = torch.matrix_exp(0.2 * (lambda a: a - a.T)(normal(3, 3)))
        viewmats[camera, :3, :3] = turn
        viewmats[camera, :3, 3] = torch.tensor([0.0, 0.0, 4.0]) + 0.3 * normal(3)
    K = torch.tensor([[1.1 * width, 0, 0.47 * width], [0, 1.2 * width, 0.55 * height], [0, 0, 1.0]])
    opacities = uniform(n)
    opacities[0], opacities[1] = 0.0, 1.0
    return {
        "means": torch.cat([1.2 * normal(n - 1, 3), torch.tensor([[0.0, 0.0, -9.0]])]),
        "quats": 2.0 * normal(n, 4),
        "scales": torch.exp(0.8 * normal(n, 3) - 1.8),
        "opacities": opacities,
        "colors": normal(c, n, d) if per_camera else normal(n, d),
        "viewmats": viewmats,
        "Ks": K.repeat(c, 1, 1),
        "backgrounds": normal(c, d),
    }


def project(t, width, height, eps2d, antialiased):
    """Projects splats in float64 by EWA splatting: means, conics, depths, opacities, visibility."""
    q = t["quats"] / t["quats"].norm(dim=-1, keepdim=True)
    w, x, y, z = q.unbind(-1)
    R = torch.stack(
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (x * y + w * z), 1 - 2 * (x * x + z * z)]
        + [2 * (y * z - w * x), 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        -1,
    ).reshape(-1, 3, 3)
    M = R * t["scales"][:, None]
    view, K = t["viewmats"], t["Ks"]
    p = torch.einsum("cij,nj->cni", view[:, :3, :3], t["means"]) + view[:, None, :3, 3]
    depth = p[..., 2]
    focal, center = K[:, [0, 1], [0, 1]][:, None], K[:, [0, 1], [2, 2]][:, None]
    side = torch.tensor([width, height], dtype=p.dtype)
    slope = p[..., :2] / depth[..., None]
    margin = 0.15 * side / focal
    clamped = torch.minimum(torch.maximum(slope, -center / focal - margin), (side - center) / focal + margin)
    J = torch.zeros(*p.shape[:2], 2, 3, dtype=p.dtype)
    J[..., 0, 0], J[..., 1, 1] = focal[..., 0] / depth, focal[..., 1] / depth
    J[..., 2] = -focal * clamped / depth[..., None]
    root = J @ (view[:, None, :3, :3] @ M)
    before = root @ root.transpose(-1, -2)
    after = before + eps2d * torch.eye(2, dtype=p.dtype)
    opacity = t["opacities"].expand(depth.shape)
    if antialiased:
        opacity = opacity * torch.sqrt((torch.linalg.det(before) / torch.linalg.det(after)).clamp_min(0.0))
    visible = (depth >= 0.01) & (opacity >= 1 / 255)
    return focal * slope + center, torch.linalg.inv(after), depth, opacity, visible


def composite(t, channels, width, height, eps2d=0.3, antialiased=False):
    """Blends channels [C, N, X] densely: images, alpha, and how near a decision is to its other side."""
    mean, conic, depth, opacity, visible = project(t, width, height, eps2d, antialiased)
    ys, xs = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    images, alphas, margins = [], [], []
    for c in range(len(depth)):
        order = torch.argsort(depth[c])[visible[c][torch.argsort(depth[c])]]
        d = torch.stack([xs, ys], -1)[:, :, None] - mean[c][order]
        power = torch.einsum("hwni,nij,hwnj->hwn", d, conic[c][order], d)
        raw = opacity[c][order] * torch.exp(-0.5 * power)
        alpha = torch.where(raw < 1 / 255, torch.zeros_like(raw), raw.clamp(max=0.999))
        behind = torch.cumprod(1 - alpha, -1)
        stopped = torch.cumsum(behind <= 1e-4, -1) > 0
        alpha = torch.where(stopped, torch.zeros_like(alpha), alpha)
        T = torch.cumprod(torch.cat([torch.ones(height, width, 1, dtype=raw.dtype), 1 - alpha], -1), -1)
        weight = alpha * T[..., :-1]
        image = torch.einsum("hwn,nx->hwx", weight, channels[c][order])
        if t["backgrounds"] is not None:
            image = image + T[..., -1:] * t["backgrounds"][c]
        images.append(image)
        alphas.append(1 - T[..., -1:])
        near = torch.minimum((raw * 255 - 1).abs(), (raw / 0.999 - 1).abs()).minimum((behind / 1e-4 - 1).abs())
        margins.append(near.amin(-1, keepdim=True) if near.shape[-1] else torch.ones(height, width, 1))
    return torch.stack(images), torch.stack(alphas), torch.stack(margins)


def double(tensors):
    return {name: None if v is None else v.detach().double().requires_grad_(name != "Ks") for name, v in tensors.items()}


def single(tensors):
    return {name: None if v is None else v.detach().clone().requires_grad_(name != "Ks") for name, v in tensors.items()}


def assert_near(name, found, expected, tolerance):
    scale = expected.abs().max().clamp_min(1e-9)
    difference = (found.double() - expected).abs().max() / scale
    assert difference <= tolerance, f"{name}: {difference:.1e} of {scale:.1e}"


def with_depth(t, mode, channels, depth, alpha=None):
    """Returns the channels that a mode blends."""
    if mode == "RGB":
        return channels
    depth = depth[..., None]
    return depth if mode in ("D", "ED") else torch.cat([channels, depth], -1)


@pytest.mark.parametrize("seed", range(20))
def test_images_and_gradients_equal_a_dense_compositor(seed):
    d, mode = [3, 1, 4, 7][seed % 4], ["RGB", "RGB+D", "ED", "RGB+ED", "D"][seed % 5]
    packed, antialiased = seed % 2 == 0, seed % 3 == 0
    size = (23, 17) if seed % 2 else (40, 35)
    start = scene(seed, d=d, size=size, per_camera=seed % 7 == 0)
    expected, found = double(start), single(start)
    channels = expected["colors"] if start["colors"].dim() == 3 else expected["colors"].expand(2, -1, -1)
    depth = project(expected, *size, 0.3, antialiased)[2]
    backgrounds = expected["backgrounds"]
    if mode != "RGB":
        zero = torch.zeros(2, 1, dtype=torch.float64)
        expected["backgrounds"] = zero if mode in ("D", "ED") else torch.cat([backgrounds, zero], -1)
    image, alpha, margin = composite(expected, with_depth(expected, mode, channels, depth), *size, antialiased=antialiased)
    if mode.endswith("ED"):
        image = torch.cat([image[..., :-1], image[..., -1:] / alpha.clamp(min=1e-10)], -1)
    image32, alpha32, meta = rasterization(
        **found, width=size[0], height=size[1], render_mode=mode, packed=packed,
        rasterize_mode="antialiased" if antialiased else "classic",
    )
    assert image32.shape == image.shape and alpha32.shape == (2, size[1], size[0], 1)
    # Where float32 may decide otherwise than float64, or alpha is tiny and divides, nothing is compared.
    safe = (margin > 1e-3) & ((alpha > 0.01) | (not mode.endswith("ED")))
    assert safe.float().mean() > 0.5
    assert_near("image", image32 * safe, image * safe, IMAGE_TOLERANCE)
    assert_near("alpha", alpha32 * safe, alpha * safe, IMAGE_TOLERANCE)
    weights = torch.randn(image.shape, generator=torch.Generator().manual_seed(seed))
    (image * weights * safe + alpha * safe).sum().backward()
    (image32 * weights * safe + alpha32 * safe).sum().backward()
    for name in NAMES:
        if mode in ("D", "ED") and name in ("colors", "backgrounds"):
            continue
        gradient = backgrounds.grad if name == "backgrounds" else expected[name].grad
        gradient = gradient[:, :3] if name == "viewmats" else gradient
        by = found[name].grad[:, :3] if name == "viewmats" else found[name].grad
        assert_near(name, by, gradient, GRADIENT_TOLERANCE)
    assert ("gaussian_ids" in meta) and (meta["gaussian_ids"] is None) == (not packed)


def test_losses_on_depths_conics_and_opacities_reach_the_splats():
    start, size = scene(3), (23, 17)
    for packed in (False, True):
        expected, found = double(start), single(start)
        mean, conic, depth, opacity, visible = project(expected, *size, 0.3, True)
        meta = rasterization(**found, width=size[0], height=size[1], packed=packed, rasterize_mode="antialiased")[2]
        seen = torch.zeros(2, 25, dtype=torch.bool)
        if packed:
            seen[meta["camera_ids"], meta["gaussian_ids"]] = True
            parts = [meta[name].sum() for name in ("means2d", "depths", "opacities")] + [meta["conics"].square().sum()]
        else:
            seen = (meta["radii"] > 0).all(-1)
            parts = [meta[name][seen].sum() for name in ("means2d", "depths", "opacities")] + [meta["conics"][seen].square().sum()]
        assert (seen & ~visible).sum() == 0 and seen.sum() > 20
        sum(parts).backward()
        squares = conic[..., 0, 0] ** 2 + conic[..., 0, 1] ** 2 + conic[..., 1, 1] ** 2
        (mean.sum(-1) + depth + opacity + squares)[seen].sum().backward()
        for name in ("means", "quats", "scales", "opacities"):
            assert_near(name, found[name].grad, expected[name].grad, GRADIENT_TOLERANCE)


@pytest.mark.parametrize("packed", [False, True])
def test_means2d_receive_the_gradients_that_densification_reads(packed):
    start, size = scene(8), (23, 17)
    found = single(start)
    image, _, meta = rasterization(**found, width=size[0], height=size[1], packed=packed, absgrad=True)
    meta["means2d"].retain_grad()
    image.square().sum().backward()
    gradient, absolute = meta["means2d"].grad, meta["means2d"].absgrad
    assert gradient.shape == absolute.shape == meta["means2d"].shape
    assert gradient.abs().max() > 0 and (absolute >= gradient.abs() - 1e-4 * absolute.max()).all()
    # Central differences: moving every splat of a camera by a pixel is moving its principal point.
    per_camera = torch.zeros(2, 2)
    if packed:
        per_camera.index_add_(0, meta["camera_ids"], gradient)
    else:
        per_camera = gradient.sum(1)
    doubles, h = double(start), 1e-5
    for camera, axis in ((0, 0), (1, 1)):
        values = []
        for step in (h, -h):
            moved = dict(doubles, Ks=doubles["Ks"].detach().clone())
            moved["Ks"][camera, axis, 2] += step
            values.append(composite(moved, doubles["colors"].expand(2, -1, -1), *size)[0].square().sum().item())
        numeric = (values[0] - values[1]) / (2 * h)
        # The limits of the Jacobian's slope move along, and thresholds may be crossed.
        assert abs(per_camera[camera, axis] - numeric) < 0.02 * abs(numeric) + 0.05


@pytest.mark.parametrize("degree,per_camera", [(0, False), (2, True), (3, False), (4, False)])
def test_harmonics_are_what_blending_by_colour_sees(degree, per_camera):
    size, n = (23, 17), 25
    start = scene(40 + degree)
    g = torch.Generator().manual_seed(degree)
    coefficients = 0.3 * torch.randn(*((2,) if per_camera else ()), n, (degree + 1) ** 2 + 1, 3, generator=g)
    one, two = single(dict(start, colors=coefficients)), single(dict(start, colors=coefficients))
    image = rasterization(**one, width=size[0], height=size[1], sh_degree=degree, packed=degree == 3)[0]
    colors = sh_radiance(two["means"], two["viewmats"], two["colors"], degree)
    other = rasterization(**dict(two, colors=colors), width=size[0], height=size[1])[0]
    assert torch.equal(image, other)
    for value in (image, other):
        value.square().sum().backward()
    for name in ("means", "colors", "viewmats", "opacities"):
        assert_near(name, one[name].grad, two[name].grad.double(), 1e-5)
    assert one["colors"].grad[..., -1, :].abs().max() == 0


def test_radiance_of_lcd_has_the_gradients_of_its_formula():
    start = scene(9, n=12)
    g = torch.Generator().manual_seed(2)
    chroma, raw = torch.randn(12, 4, 3, generator=g), torch.randn(12, 4, generator=g)
    for activation, apply in (("softplus", torch.nn.functional.softplus), ("exp", torch.exp), ("relu", torch.relu)):
        tensors = [v.clone().requires_grad_() for v in (start["means"], start["viewmats"], chroma, raw)]
        doubles = [v.detach().double().requires_grad_() for v in tensors]
        found = lcd_radiance(*tensors, activation=activation)
        means, viewmats, chroma64, raw64 = doubles
        offset = means - torch.linalg.inv(viewmats)[:, None, :3, 3]
        x, y, z = (offset / offset.norm(dim=-1, keepdim=True)).unbind(-1)
        c0, c1 = math.sqrt(1 / (4 * math.pi)), math.sqrt(3 / (4 * math.pi))
        basis = torch.stack([torch.full_like(x, c0), -c1 * y, c1 * z, -c1 * x], -1)
        # The floor of a dead chromaticity, and a constant that is no harmonic: see core's colour model.
        response = torch.relu(torch.einsum("cnm,nmk->cnk", basis, chroma64)) + 1e-3
        luminance = apply(raw64[:, 0] + torch.einsum("cnm,nm->cn", basis[..., 1:], raw64[:, 1:]))
        expected = luminance[..., None] * response / response.sum(-1, keepdim=True)
        assert_near("radiance", found, expected, 5e-6)
        found.square().sum().backward()
        expected.square().sum().backward()
        for tensor, reference in zip(tensors, doubles):
            assert_near(activation, tensor.grad, reference.grad, GRADIENT_TOLERANCE)


def test_splats_in_spatial_order_make_the_same_image():
    tensors = scene(15, n=300)
    order = spatial_order(tensors["means"])
    assert sorted(order.tolist()) == list(range(300))
    ordered = {name: value[order] if value.shape[:1] == (300,) else value for name, value in tensors.items()}
    images = [rasterization(**given, width=23, height=17, packed=False)[0] for given in (tensors, ordered)]
    assert torch.equal(*images)
    steps = [tensors["means"][places].diff(dim=0).norm(dim=1).mean() for places in (torch.arange(300), order)]
    assert steps[1] < 0.5 * steps[0]
    with pytest.raises(luxel.LuxelError, match="means: tensor of shape"):
        spatial_order(torch.zeros(3))


def test_log_harmonics_are_the_exponential_of_harmonics():
    start = scene(14, c=2)
    sh = 0.3 * torch.randn(len(start["means"]), 9, 3, generator=torch.Generator().manual_seed(3))
    tensors = [v.clone().requires_grad_() for v in (start["means"], start["viewmats"], sh)]
    others = [v.clone().requires_grad_() for v in (start["means"], start["viewmats"], sh)]
    found = log_sh_radiance(*tensors, degree=2)
    # Plus 20, so that no colour of the plain harmonics is cut off at zero.
    lifted = torch.zeros_like(sh)
    lifted[:, 0] = 20 * math.sqrt(4 * math.pi)
    expected = torch.exp(sh_radiance(others[0], others[1], others[2] + lifted, 2) - 20)
    assert_near("radiance", found, expected, 3e-5)
    found.square().sum().backward()
    expected.square().sum().backward()
    for tensor, reference in zip(tensors, others):
        assert_near("gradient", tensor.grad, reference.grad, 1e-4)


def test_results_are_the_same_bits_for_any_number_of_threads_and_graphs_may_be_kept():
    start = scene(12, n=200, d=5)
    threads, results = torch.get_num_threads(), []
    try:
        for count in (1, 2):
            torch.set_num_threads(count)
            tensors = single(start)
            image, alpha, _ = rasterization(**tensors, width=60, height=50)
            other = single(scene(13, n=60))
            rasterization(**other, width=30, height=20)[0].sum().backward()
            loss = image.square().sum() + alpha.sum()
            loss.backward(retain_graph=True)
            first = [tensors[name].grad.clone() for name in NAMES]
            loss.backward()
            assert all(torch.equal(2 * once, tensors[name].grad) for name, once in zip(NAMES, first))
            results.append([image.detach(), alpha.detach(), *first])
    finally:
        torch.set_num_threads(threads)
    assert all(torch.equal(a, b) for a, b in zip(*results))


def test_arguments_that_are_not_supported_are_refused():
    start = {name: v for name, v in scene(1).items()}
    call = lambda **changes: rasterization(**dict(start, **changes), width=9, height=8)  # noqa: E731
    messages = {
        "rasterization: distributed is not supported on the CPU; leave it at its default": dict(distributed=True),
        "sparse_grad: needs packed=True": dict(sparse_grad=True, packed=False),
        "rasterization: camera_model 'fisheye' is not supported on the CPU; leave it at its default": dict(camera_model="fisheye"),
        "rasterization: with_ut is not supported on the CPU; leave it at its default": dict(with_ut=True),
        "covars: tensor of shape [25, 6], expected [25, 3, 3]": dict(covars=torch.zeros(25, 6)),
        "quats: tensor of shape [25, 4], expected [1, 25, 4]": dict(means=start["means"][None], viewmats=start["viewmats"][None]),
        "render_mode: expected one of RGB, D, ED, RGB+D, RGB+ED, found 'N'": dict(render_mode="N"),
        'rasterize_mode: expected "classic" or "antialiased", found \'mip\'': dict(rasterize_mode="mip"),
        "means: expected float32, found torch.float64; call .float()": dict(means=start["means"].double()),
        "quats: tensor of shape [25, 3], expected [25, 4]": dict(quats=torch.zeros(25, 3)),
        "colors: tensor of shape [24, 3], expected [25, any] or [2, 25, any]": dict(colors=torch.zeros(24, 3)),
        "sh_degree: degree 3 needs 16 coefficients, found 4": dict(sh_degree=3, colors=torch.zeros(25, 4, 3)),
        "eps2d: expected a number of at least 0.0, found -1": dict(eps2d=-1),
        "Ks: there is no gradient by intrinsics; pass Ks.detach()": dict(Ks=start["Ks"].clone().requires_grad_()),
        "Ks[0]: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], found [1.0, 0.5,": dict(
            Ks=torch.tensor([[1.0, 0.5, 0], [0, 1, 0], [0, 0, 1]]).repeat(2, 1, 1)
        ),
    }
    for message, changes in messages.items():
        with pytest.raises(luxel.LuxelError) as raised:
            call(**changes)
        assert str(raised.value).startswith(message), str(raised.value)


def test_sizes_may_be_any_whole_numbers():
    start = scene(1)
    expected = rasterization(**start, width=9, height=8, near_plane=0.5)[0]
    found = rasterization(**start, width=np.int64(9), height=torch.tensor(8), near_plane=np.float32(0.5))[0]
    assert torch.equal(found, expected)
    for width in (0, 9.0, "9"):
        with pytest.raises(luxel.LuxelError, match="width: expected a whole number"):
            rasterization(**start, width=width, height=8)


def test_gradients_are_the_same_with_and_without_one_by_the_camera():
    found = []
    for wanted in (False, True):
        start = {name: v.requires_grad_(name != "Ks" and (wanted or name != "viewmats")) for name, v in scene(3).items()}
        rasterization(**start, width=23, height=17)[0].sum().backward()
        found.append([start[name].grad for name in ("means", "quats", "scales", "opacities", "colors")])
        assert (start["viewmats"].grad is not None) == wanted
    assert all(torch.equal(one, other) for one, other in zip(*found))


def test_projection_and_harmonics_equal_those_of_gsplat():
    gsplat = pytest.importorskip("gsplat.cuda._torch_impl")
    start = scene(21, n=60)
    meta = rasterization(**start, width=23, height=17, packed=False, rasterize_mode="antialiased")[2]
    doubles = {name: v.double() for name, v in start.items()}
    covars, _ = gsplat._quat_scale_to_covar_preci(doubles["quats"], doubles["scales"], True, False)
    _, means2d, depths, conics, compensations = gsplat._fully_fused_projection(
        doubles["means"], covars, doubles["viewmats"], doubles["Ks"], 23, 17, calc_compensations=True
    )
    seen = (meta["radii"] > 0).all(-1)
    assert seen.sum() > 40
    opacities = doubles["opacities"] * compensations
    for name, expected in (("means2d", means2d), ("depths", depths), ("conics", conics), ("opacities", opacities)):
        assert_near(name, meta[name][seen], expected[seen], 5e-6)
    coefficients = torch.randn(60, 16, 3, generator=torch.Generator().manual_seed(1))
    directions = start["means"] - torch.inverse(start["viewmats"])[:, None, :3, 3]
    expected = gsplat._spherical_harmonics(3, directions, coefficients.expand(2, -1, -1, -1))
    found = sh_radiance(start["means"], start["viewmats"], coefficients, 3)
    assert_near("harmonics", found, (expected + 0.5).clamp_min(0.0).double(), 5e-6)


def test_second_derivatives_are_refused():
    t = scene(3)
    means, sh = t["means"].requires_grad_(), torch.zeros(25, 4, 3, requires_grad=True)
    radiance = sh_radiance(means, t["viewmats"], sh, 1)
    image, _, _ = rasterization(means, t["quats"], t["scales"], t["opacities"], radiance, t["viewmats"], t["Ks"], 23, 17)
    (first,) = torch.autograd.grad(image.square().sum(), means, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        first.square().sum().backward()
    radiance = sh_radiance(means, t["viewmats"], sh, 1)
    (first,) = torch.autograd.grad(radiance.square().sum(), sh, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        first.square().sum().backward()


FORK = """
import os, sys
import torch
import luxel
from luxel.torch import rasterization

torch.set_num_threads(2)
view, K = torch.eye(4)[None], torch.tensor([[[20.0, 0, 8], [0, 20, 8], [0, 0, 1]]])
means = torch.tensor([[0.0, 0.0, 2.0]], requires_grad=True)

def image():
    rest = torch.tensor([[1.0, 0, 0, 0]]), torch.full((1, 3), 0.1), torch.tensor([0.9]), torch.tensor([[4.0, 2.0, 1.0]])
    return rasterization(means, *rest, view, K, 16, 16)[0]

before = image()
camera = luxel.Camera.look_at([0, 0, -3], [0, 0, 0], [0, -1, 0], fov=50, width=32, height=24)
dataset = luxel.Dataset.from_arrays([torch.ones(24, 32, 3).numpy()], [camera])
child = os.fork()
if child:
    sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
after = image()
after.sum().backward()
ok = torch.equal(before, after) and means.grad.abs().sum() > 0
for refused in (lambda: before.sum().backward(), lambda: luxel.Dataset.open("absent"), lambda: luxel.train(dataset, steps=1)):
    try:
        refused()
        ok = False
    except luxel.LuxelError as error:
        ok = ok and "was forked from" in str(error) and "spawn" in error.remedy
os._exit(0 if ok else 1)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no fork")
def test_a_fork_rasterises_with_threads_of_its_own_and_is_told_of_those_that_it_lacks():
    # A child that waited for its parent's threads would never come back.
    assert subprocess.run([sys.executable, "-c", FORK], timeout=300).returncode == 0
