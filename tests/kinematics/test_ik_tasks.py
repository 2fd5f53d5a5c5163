"""OpenSim's task sets: by themselves, inside a set-up, named by one; what is refused."""

import numpy as np
import pytest

from legsim.core.errors import LegsimError
from legsim.kinematics import ik_tasks
from legsim.kinematics.ik_options import CoordinateTask
from tests.examples.task_sets import coordinate, document, marker, task_set

TASKS = task_set(
    marker("R.ASIS", 10),
    marker("Top.Head", 5, apply="false"),
    marker("R.Heel", 0.5),
    coordinate("mtp_angle_r", 1000),
    coordinate("subtalar_angle_r", 2, "manual_value", 0.1),
)


def saved(folder, text, name="tasks.xml"):
    (folder / name).write_text(text)
    return folder / name


@pytest.mark.parametrize(("apply", "markers"), [("1", {"A": 2}), ("0", {})])
def test_a_task_applies_by_a_number_too(tmp_path, apply, markers):
    tasks = task_set(marker("A", 2, apply=apply), marker("B", 1))
    assert ik_tasks.read(saved(tmp_path, tasks)).markers == {**markers, "B": 1}


@pytest.mark.parametrize(
    "around",
    [
        document,
        str,
        lambda t: document(f"<InverseKinematicsTool>{t}</InverseKinematicsTool>"),
        lambda t: f"<IKTool>{t}</IKTool>",
    ],
)
def test_tasks_that_apply_are_read_wherever_the_set_stands(tmp_path, around):
    found = ik_tasks.read(saved(tmp_path, around(TASKS)))
    assert found.markers == {"R.ASIS": 10, "R.Heel": 0.5}
    assert found.coordinates == (
        CoordinateTask("mtp_angle_r", 1000.0),
        CoordinateTask("subtalar_angle_r", 2.0, 0.1),
    )
    assert len(found.notes) == ("Tool" in around(""))


def test_a_set_up_names_its_tasks_beside_it(tmp_path):
    inner = saved(tmp_path, document(TASKS))
    tool = '<InverseKinematicsTool><IKTaskSet file="tasks.xml"/></InverseKinematicsTool>'
    setup = saved(tmp_path, document(tool), "setup.xml")
    assert ik_tasks.read(setup).markers == ik_tasks.read(inner).markers
    assert ik_tasks.files_of(setup) == (setup, inner)
    assert ik_tasks.files_of(inner) == (inner,)
    inner.unlink()
    with pytest.raises(LegsimError, match=r"setup\.xml.*its task set tasks\.xml is not there"):
        ik_tasks.read(setup)


def test_what_a_task_leaves_out_is_opensims_default(tmp_path):
    bare = task_set('<IKMarkerTask name="a"/>', '<IKCoordinateTask name="b"/>')
    found = ik_tasks.read(saved(tmp_path, document(bare)))
    assert (found.markers, found.coordinates) == ({"a": 0.0}, (CoordinateTask("b", 0.0),))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (document("<ScaleTool/>"), "no IKTaskSet of that tool, but ScaleTool"),
        (document(TASKS + TASKS), "holds 2 IKTaskSets"),
        ("<Model/>", "begins with <Model>"),
        (document(task_set()), "no task that applies"),
        (document(task_set(marker("a", 1, apply="false"))), "no task that applies"),
        (document(task_set(marker("a", 1), marker("a", 2))), "a has two tasks"),
        (document(task_set(marker("", 1))), "IKMarkerTask has no name"),
        (document(task_set(marker("a", -1))), "the weight of a is -1"),
        (document(task_set(marker("a", "x"))), "task of a: <weight> holds .x., not finite"),
        (document(task_set(marker("a", "1 2"))), "<weight> of a holds 2 numbers"),
        (document(task_set(coordinate("b", 1, "from_file"))), "b takes its value from a file"),
        (document(task_set(coordinate("b", 1, "zero"))), "the value_type of b is .zero."),
        (document(task_set('<IKOther name="c"/>')), "holds <IKOther>"),
    ],
)
def test_what_cannot_be_followed_is_refused_with_the_file(tmp_path, text, said):
    with pytest.raises(LegsimError, match=rf"tasks\.xml.*{said}") as caught:
        ik_tasks.read(saved(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_the_set_up_that_comes_with_gait2392(shared_data):
    found = ik_tasks.read(shared_data / "opensim/subject01_Setup_IK.xml")
    assert len(found.markers) == 31
    assert found.markers["R.ASIS"] == 10
    assert {t.coordinate for t in found.coordinates} == {
        f"{part}_angle_{side}" for part in ("subtalar", "mtp") for side in "rl"
    }
    np.testing.assert_array_equal([t.weight for t in found.coordinates], 1000)


def test_a_set_up_of_scaling_is_refused(shared_data):
    with pytest.raises(LegsimError, match="but ScaleTool"):
        ik_tasks.read(shared_data / "opensim/subject01_Setup_Scale.xml")
