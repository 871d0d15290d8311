import torch

from physkin_training.train.steadiness import DETAIL_SLACK, REACH, SLACK, Steadiness

STIFFNESS = 50.0
AXIS = torch.tensor([1.0, 0.0, 0.0])


class Bodies:
    """Bones that do not move."""

    def bone_transforms(self, positions, body):
        return torch.eye(4)[:3].expand(len(positions), 1, 3, 4)


class Drape:
    """One garment node; `jump` [m] to the side wherever the first joint is above 0."""

    lower, upper = torch.tensor([-1.0, -1.0]), torch.tensor([1.0, 1.0])

    def __init__(self, jump):
        self.jump = torch.tensor(jump, requires_grad=True)

    def posed_nodes(self, bones, node_positions):
        return torch.cat([bones[..., :3], node_positions[..., None]], dim=-1)

    def draped(self, modulation, positions, gravity, posed_nodes):
        side = torch.tensor([0.0, 0.0, 0.0, 1.0]) * torch.eye(3)[:1].T
        return posed_nodes + self.jump * (positions[:, :1] > 0).float()[:, :, None, None] * side, None


def penalty(drape, first_joint, samples=400):
    torch.manual_seed(0)
    positions = torch.zeros(samples, 2)
    positions[:, 0] = first_joint
    where = torch.zeros(samples, 1, 3)
    posed = drape.posed_nodes(Bodies().bone_transforms(positions, None), where)
    nodes, detail = drape.draped(None, positions, None, posed)
    given = {"modulation": None, "gravity": None, "body": torch.zeros(samples, dtype=torch.int64)}
    return Steadiness(drape, Bodies(), STIFFNESS)(
        nodes, posed, detail, positions=positions, node_positions=where, **given
    )


def test_nodes_that_jump_cost_energy_where_they_jump_and_nowhere_else():
    """At the switch half of the poses beside are on the other side: half of stiffness times excess squared."""
    drape = Drape(0.1)
    there = penalty(drape, 0.0)
    torch.testing.assert_close(float(there), 0.5 * STIFFNESS * (0.1 - SLACK) ** 2, rtol=0.15, atol=0)
    there.backward()
    assert drape.jump.grad > 0
    assert penalty(drape, 0.9) == 0 and penalty(drape, -0.9) == 0
    assert penalty(Drape(0.9 * SLACK), 0.0) == 0


def test_nodes_that_stay_and_turn_cost_energy_for_the_cloth_beside_them():
    """A node that shrinks along one axis: the point there jumps, one of four."""

    class Shrinking(Drape):
        def draped(self, modulation, positions, gravity, posed_nodes):
            along = torch.tensor([1.0, 0.0, 0.0, 0.0]) * torch.eye(3)[:1].T
            return posed_nodes - self.jump * (positions[:, :1] > 0).float()[:, :, None, None] * along, None

    there = float(penalty(Shrinking(0.8), 0.0))
    torch.testing.assert_close(there, 0.5 * STIFFNESS * (0.8 * REACH - SLACK) ** 2 / 4, rtol=0.15, atol=0)


def test_detail_nodes_that_jump_cost_energy():
    """One of four jumps, and one moves by less than the slack."""

    class Folding(Drape):
        def draped(self, modulation, positions, gravity, posed_nodes):
            there = (positions[:, :1] > 0).float()[..., None]
            return posed_nodes, there * torch.tensor([self.jump, 0.9 * DETAIL_SLACK, 0, 0])[:, None].expand(4, 3) * AXIS

    there = float(penalty(Folding(0.02), 0.0))
    torch.testing.assert_close(there, 0.5 * STIFFNESS * (0.02 - DETAIL_SLACK) ** 2 / 4, rtol=0.15, atol=0)
    assert penalty(Folding(0.9 * DETAIL_SLACK), 0.0) == 0


def test_what_a_bone_moves_is_free():
    class Swinging(Bodies):
        def bone_transforms(self, positions, body):
            transforms = super().bone_transforms(positions, body).clone()
            transforms[:, 0, 0, 3] = positions[:, 0]
            return transforms

    class Carried(Drape):
        def posed_nodes(self, bones, node_positions):
            return bones

    drape = Carried(0.0)
    positions = torch.zeros(50, 2)
    posed = Swinging().bone_transforms(positions, None)
    given = {"modulation": None, "gravity": None, "body": None, "node_positions": None, "positions": positions}
    assert Steadiness(drape, Swinging(), STIFFNESS)(posed, posed, **given) == 0
