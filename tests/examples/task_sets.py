"""OpenSim's tasks of inverse kinematics as XML."""


def marker(name: str, weight: object, apply: str = "true") -> str:
    """A task of a marker."""
    return (
        f'<IKMarkerTask name="{name}"><apply>{apply}</apply><weight>{weight}</weight>'
        "</IKMarkerTask>"
    )


def coordinate(name: str, weight: object, kind: str = "default_value", value: float = 0.0) -> str:
    """A task of a coordinate."""
    return (
        f'<IKCoordinateTask name="{name}"><apply>true</apply><weight>{weight}</weight>'
        f"<value_type>{kind}</value_type><value>{value}</value></IKCoordinateTask>"
    )


def task_set(*tasks: str) -> str:
    """The set of tasks."""
    return f'<IKTaskSet name="t"><objects>{"".join(tasks)}</objects></IKTaskSet>'


def document(text: str) -> str:
    """A document of OpenSim around it."""
    return f'<OpenSimDocument Version="30000">{text}</OpenSimDocument>'
