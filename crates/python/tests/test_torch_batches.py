"""Batch dimensions, covariances and sparse gradients of `luxel.torch.rasterization`."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")

from test_torch import NAMES, assert_near, double, scene, single  # noqa: E402

from luxel.torch import rasterization  # noqa: E402


def test_batches_are_the_scenes_one_by_one():
    size = (23, 17)
    scenes = [scene(seed, n=20) for seed in (31, 32, 33, 34, 35, 36)]
    for packed in (False, True):
        stacked = single({name: torch.stack([s[name] for s in scenes]).reshape(2, 3, *scenes[0][name].shape) for name in scenes[0]})
        image, alpha, meta = rasterization(**stacked, width=size[0], height=size[1], render_mode="RGB+D", packed=packed, absgrad=True)
        assert image.shape == (2, 3, 2, size[1], size[0], 4) and alpha.shape == (2, 3, 2, size[1], size[0], 1)
        meta["means2d"].retain_grad()
        image.square().sum().backward()
        assert (meta["means2d"].absgrad >= meta["means2d"].grad.abs() * (1 - 1e-4)).all() and meta["n_batches"] == 6
        for n, one in enumerate(scenes):
            place, one = (n // 3, n % 3), single(one)
            expected, expected_alpha, info = rasterization(**one, width=size[0], height=size[1], render_mode="RGB+D", packed=packed, absgrad=True)
            info["means2d"].retain_grad()
            expected.square().sum().backward()
            assert torch.equal(image[place], expected) and torch.equal(alpha[place], expected_alpha)
            for name in NAMES:
                assert torch.equal(stacked[name].grad[place], one[name].grad), name
            rows = meta["batch_ids"] == n if packed else place
            for name in ("depths", "radii", "conics"):
                assert torch.equal(meta[name][rows], info[name])
            assert torch.equal(meta["means2d"].grad[rows], info["means2d"].grad)
            assert torch.equal(meta["means2d"].absgrad[rows], info["means2d"].absgrad)


def test_harmonics_have_batch_dimensions_too():
    scenes = [dict(scene(seed, n=12), colors=torch.randn(12, 9, 3, generator=torch.Generator().manual_seed(seed))) for seed in (1, 2)]
    stacked = {name: torch.stack([s[name] for s in scenes]) for name in scenes[0]}
    image = rasterization(**stacked, width=23, height=17, sh_degree=2)[0]
    assert all(torch.equal(image[n], rasterization(**s, width=23, height=17, sh_degree=2)[0]) for n, s in enumerate(scenes))


@pytest.mark.parametrize("antialiased", [False, True])
def test_covariances_are_what_quaternions_and_scales_make(antialiased):
    size, mode = (23, 17), "antialiased" if antialiased else "classic"
    start = scene(17)
    # Splats with equal axes have no gradient by rotation, but by covariance.
    start["scales"][3] = 0.2
    expected = double(start)
    q = expected["quats"] / expected["quats"].norm(dim=-1, keepdim=True)
    w, x, y, z = q.detach().unbind(-1)
    R = torch.stack(
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (x * y + w * z), 1 - 2 * (x * x + z * z)]
        + [2 * (y * z - w * x), 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        -1,
    ).reshape(-1, 3, 3)
    covars = (R * expected["scales"].detach()[:, None].square()) @ R.transpose(1, 2)
    found = {name: v for name, v in single(start).items() if name not in ("quats", "scales")}
    found["covars"] = covars.float().requires_grad_()
    image, alpha, meta = rasterization(**found, quats=None, scales=None, width=size[0], height=size[1], rasterize_mode=mode)
    other = single(start)
    same = rasterization(**other, width=size[0], height=size[1], rasterize_mode=mode)[0]
    assert_near("image", image, same.detach().double(), 2e-4)
    image.square().sum().backward()
    same.square().sum().backward()
    for name in ("means", "opacities", "colors", "viewmats"):
        assert_near(name, found[name].grad, other[name].grad.double(), 2e-3)
    # The chain rule from covariances to scales and quaternions.
    s, quats = expected["scales"], expected["quats"]
    q = quats / quats.norm(dim=-1, keepdim=True)
    w, x, y, z = q.unbind(-1)
    R = torch.stack(
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (x * y + w * z), 1 - 2 * (x * x + z * z)]
        + [2 * (y * z - w * x), 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        -1,
    ).reshape(-1, 3, 3)
    upper = found["covars"].grad.double()
    assert (upper.tril(-1) == 0).all() and upper[3].triu(1).abs().max() > 0
    (upper * ((R * s[:, None].square()) @ R.transpose(1, 2))).sum().backward()
    assert_near("scales", other["scales"].grad, s.grad, 2e-3)
    assert_near("quats", other["quats"].grad, quats.grad, 2e-3)


def test_sparse_gradients_hold_the_splats_that_a_camera_sees():
    start = scene(19, n=60)
    start["means"][:20, 2] = -9.0
    one, two = single(start), single(start)
    rasterization(**one, width=23, height=17)[0].square().sum().backward()
    meta = rasterization(**two, width=23, height=17, sparse_grad=True)[2]
    image = rasterization(**two, width=23, height=17, sparse_grad=True)[0]
    image.square().sum().backward()
    for name in ("means", "quats", "scales"):
        gradient = two[name].grad
        assert gradient.is_sparse and gradient._nnz() == len(torch.unique(meta["gaussian_ids"])) < 60
        assert torch.equal(gradient.to_dense(), one[name].grad)
    assert not two["opacities"].grad.is_sparse
    torch.optim.SparseAdam([two["means"]], lr=1e-3).step()
