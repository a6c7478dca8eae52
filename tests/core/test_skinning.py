"""All implementations of forward kinematics and linear blend skinning agree with each other and with a naive loop."""

import numpy as np
import pytest
from people import rigged

from mimesh.bodies import load_body
from mimesh.bodies.sampled_body import BodyState, PosedBody, SampledBody
from mimesh.bodies.sampling import JOINT_LIMITS, rotvec_to_rotmat, sample_pose, sample_shape
from mimesh.core.rig import Rig, descendant_matrix, descendants
from mimesh.core.skinning import SkinnedMesh, place_joints, skin_points, skin_poses, skinning_transforms
from mimesh.core.surface_points import at_barycentric, interpolate, sample_surface
from mimesh.motions.bvh import Bvh

BODY = load_body()
SHAPE, ROTVEC, ROOT = sample_shape(BODY, 3, 0), sample_pose(BODY, 3, 0, JOINT_LIMITS), np.array([0.1, -0.2, 0.3])
ROTMAT = rotvec_to_rotmat(ROTVEC)
VERTICES, JOINTS = BODY.shaped(SHAPE)
ROTATION, TRANSLATION = skinning_transforms(JOINTS, ROTMAT, BODY.parents, ROOT)
POSED = skin_points(VERTICES, BODY.weights, ROTATION, TRANSLATION)
POSITIONS = np.einsum("jkl,jl->jk", ROTATION, JOINTS) + TRANSLATION


def assert_equal(found, expected):
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_transforms_and_skinning_agree_with_a_naive_loop():
    world = []
    for j, parent in enumerate(BODY.parents):
        local = np.eye(4)
        local[:3, :3] = ROTMAT[j]
        local[:3, 3] = JOINTS[j] - JOINTS[parent] if parent >= 0 else JOINTS[j] + ROOT
        world.append(local if parent < 0 else world[parent] @ local)
    assert_equal(np.stack(world)[:, :3, 3], POSITIONS)
    for v in range(0, len(VERTICES), 997):
        point = np.zeros(3)
        for j, transform in enumerate(world):
            point += BODY.weights[v, j] * (transform[:3, :3] @ (VERTICES[v] - JOINTS[j]) + transform[:3, 3])
        assert_equal(POSED[v], point)


@pytest.mark.parametrize(("people", "poses"), [(None, None), (2, None), (None, 2), (2, 2)])
def test_batches_of_people_and_poses_broadcast(people, poses):
    shapes = SHAPE if people is None else np.stack([SHAPE, -SHAPE])
    rotmats = ROTMAT if poses is None else np.stack([ROTMAT, np.swapaxes(ROTMAT, -1, -2)])
    posed = BODY.posed(shapes, rotmats, ROOT)
    assert posed.shape == ((2,) if people or poses else ()) + VERTICES.shape
    assert_equal(posed[0] if posed.ndim == 3 else posed, POSED)
    if posed.ndim == 3:
        last = BODY.posed(shapes[-1] if people else shapes, rotmats[-1] if poses else rotmats, ROOT)
        assert_equal(posed[1], last)


def test_skinning_of_poses_is_that_of_points_and_joints_from_world_rotations_are_those_of_the_transforms():
    assert_equal(skin_poses(VERTICES, BODY.weights, ROTATION, TRANSLATION), POSED)
    bones = JOINTS[1:] - JOINTS[list(BODY.parents[1:])]
    assert_equal(place_joints(JOINTS[0] + ROOT, bones, ROTATION, BODY.parents), POSITIONS)


def test_a_packed_mesh_is_the_skinned_points_in_single_precision():
    """So is a part of its vertices in any order, and a mesh whose joint frames have not the world's axes."""
    rig = Rig(np.tile(np.eye(3), (len(JOINTS), 1, 1)), JOINTS, BODY.weights)
    skinned = SkinnedMesh.of(VERTICES, rig, BODY.parents)
    assert_equal(skinned.joint_positions(ROTATION, POSITIONS[0]), POSITIONS)
    chosen = np.array([7, 3, 3, len(VERTICES) - 1, 0])
    turned = SkinnedMesh.of(POSED, Rig(ROTATION, POSITIONS, BODY.weights), BODY.parents)
    for mesh, expected in ((skinned, POSED), (skinned.part(chosen), POSED[chosen]), (turned, POSED)):
        np.testing.assert_allclose(mesh.posed(ROTATION, POSITIONS[0]), expected, rtol=0, atol=2e-6)


def test_a_sampled_body_is_the_skinned_points_for_any_proportions():
    sampled = SampledBody.of(BODY, 300)
    rng = np.random.default_rng(0)
    bones = 0.2 * rng.normal(size=sampled.unknowns["bones"].stop - sampled.unknowns["bones"].start)
    vertices = sampled.vertices + sampled.components @ SHAPE
    for size, logarithms in ((1.0, np.zeros_like(bones)), (1.3, bones)):
        posed = PosedBody(sampled, BodyState(size, POSITIONS[0], SHAPE, logarithms, ROTATION))
        translation = posed.joints - np.einsum("jkl,jl->jk", posed.linear, JOINTS)
        assert_equal(posed.points, skin_points(vertices, sampled.weights, posed.linear, translation))
        if size == 1:
            assert_equal(posed.linear, ROTATION)
            assert_equal(posed.joints, POSITIONS)


def test_a_character_with_one_rest_point_per_vertex_is_the_skinned_body():
    character = rigged(BODY.mesh(VERTICES), BODY.joint_names, BODY.parents, JOINTS, BODY.weights)
    assert_equal(character.posed(ROTMAT, ROOT), POSED)


def test_a_bvh_skeleton_is_placed_as_the_body():
    offsets = JOINTS - JOINTS[[max(parent, 0) for parent in BODY.parents]]
    source = Bvh("body", BODY.joint_names, BODY.parents, offsets, {}, ROTMAT[None], (JOINTS[0] + ROOT)[None], 30.0)
    rotation, positions = source.world()
    assert_equal(rotation[0], ROTATION)
    assert_equal(positions[0], POSITIONS)


def test_torch_bodies_are_the_numpy_bodies():
    torch = pytest.importorskip("torch")
    from mimesh.learn.data import bodies as learn_bodies

    twin = learn_bodies.TorchBody(BODY, torch.float64)
    shape, rotmat = torch.from_numpy(SHAPE)[None], torch.from_numpy(ROTMAT)[None]
    expected = BODY.posed(SHAPE, ROTMAT)
    assert_equal(twin.posed(shape, rotmat)[0].numpy(), expected)
    index = torch.arange(0, len(VERTICES), 7)[None]
    assert_equal(twin.posed(shape, rotmat, index)[0].numpy(), expected[::7])
    rotation, translation = BODY.skinning_transforms(JOINTS, ROTMAT)
    assert_equal(
        twin.skinning_transforms(shape, rotmat)[0].numpy(), np.concatenate([rotation, translation[..., None]], -1)
    )
    # Gradients need a rotation formula of their own.
    assert_equal(learn_bodies.rotvec_to_rotmat(torch.from_numpy(ROTVEC)).numpy(), ROTMAT)
    assert_equal(learn_bodies.rotvec_to_rotmat(torch.zeros(3)).numpy(), np.eye(3))
    single = learn_bodies.TorchBody(BODY).posed(shape.float(), rotmat.float())[0].numpy()
    np.testing.assert_allclose(single, expected, rtol=0, atol=5e-6)


def test_torch_skinning_from_any_pose_is_that_of_a_packed_mesh():
    torch = pytest.importorskip("torch")
    from mimesh.learn.data import bodies as twin

    target = np.swapaxes(ROTATION, -1, -2)
    skinned = SkinnedMesh.of(POSED, Rig(ROTATION, POSITIONS, BODY.weights), BODY.parents)
    tensors = [torch.from_numpy(a)[None] for a in (POSED, BODY.weights, ROTATION, POSITIONS, target)]
    vertices, weights, rotation, joints, target_rotation = tensors
    moved = twin.posed_joints(rotation, joints, target_rotation, torch.from_numpy(ROOT)[None], BODY.parents)
    assert_equal(moved[0].numpy(), skinned.joint_positions(target, ROOT))
    found = twin.skinned(vertices, weights, rotation, joints, target_rotation, moved)[0].numpy()
    turn = target @ np.swapaxes(ROTATION, -1, -2)
    translation = moved[0].numpy() - np.einsum("jkl,jl->jk", turn, POSITIONS)
    assert_equal(found, skin_points(POSED, BODY.weights, turn, translation))
    np.testing.assert_allclose(found, skinned.posed(target, ROOT), rtol=0, atol=5e-6)


def test_the_descendant_matrix_is_the_list_of_descendants():
    matrix = descendant_matrix(BODY.parents)
    for j in range(len(BODY.parents)):
        assert np.flatnonzero(matrix[j]).tolist() == descendants([j], BODY.parents)
    assert set(matrix.ravel()) == {0.0, 1.0}
    assert descendants([3], (1, 2, 3, -1, -1, 4)) == [0, 1, 2, 3], "children before their parents"
    with pytest.raises(ValueError, match="read-only"):
        matrix[0, 0] = 0


def test_interpolation_takes_any_values_of_vertices():
    face, barycentric = sample_surface(BODY.vertices, BODY.faces, 20, np.random.default_rng(0))
    corners = BODY.faces[face]
    for values in (BODY.vertices, BODY.weights, BODY.components):
        naive = np.einsum("nk,...nkc->...nc", barycentric, values[..., corners, :])
        assert_equal(interpolate(values, corners, barycentric), naive)
        np.testing.assert_array_equal(
            at_barycentric(values, BODY.faces, face, barycentric), interpolate(values, corners, barycentric)
        )
