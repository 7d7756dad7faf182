"""What people may ask of a planner while it runs: to pause, to leave a task alone, other settings, a plan now."""

from __future__ import annotations

import re
from functools import partial
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from humanpred_ros import topics
from humanpred_ros.errors import HumanPredError, UsageError, one_line
from humanpred_ros.nodes.commanding_node import CommandingNode
from humanpred_ros.nodes.parameters import declare_setting, plugin_parameters
from humanpred_ros.settings import setting

PAUSED = "paused: somebody called the service pause; resume lets it go on"
#: Parameters TASK_COSTS.NAME are the tasks' costs.
TASK_COSTS = "task_costs"


def declare_task_costs(node: CommandingNode) -> dict[str, float]:
    """Declare the costs of the tasks as parameters that may change, and return them by task.

    Raises:
        UsageError: one is given for a task that there is none of, or cannot be used.
    """
    costs = node.replanner.problem.task_costs
    for name in node._parameter_overrides:
        prefix, _, task = name.partition(".")
        if prefix == TASK_COSTS and task not in costs:
            raise UsageError(f"parameter {name}: wanted a task of the scene ({', '.join(costs)}), got {task!r}")
    return {
        name: declare_setting(
            node,
            f"{TASK_COSTS}.{name}",
            setting(cost, f"cost of choosing task {name} beside disturbing the person", low=0.0, changeable=True),
        )
        for name, cost in costs.items()
    }


def take_parameters(node: CommandingNode, parameters: list[Parameter]) -> SetParametersResult:
    """Let other values of parameters count from the next occupancy on, all or none; the reason says what is wrong."""
    prefix = f"{TASK_COSTS}."
    values: dict[str, Any] = {p.name: tuple(p.value) if isinstance(p.value, list) else p.value for p in parameters}
    costs = {name.removeprefix(prefix): value for name, value in values.items() if name.startswith(prefix)}
    changes = {name: value for name, value in values.items() if not name.startswith(prefix)}
    try:
        settings = node.settings.replaced(**changes)
        config = settings.replanner_config(plugin_parameters(node, settings.cost_terms))
        tasks = node.tasks if settings.tasks == node.settings.tasks else node.tasks_of(settings.tasks)
        node.replanner.change(config, costs, goals=None if tasks is node.tasks else tuple(tasks.values()))
    except HumanPredError as error:
        return SetParametersResult(successful=False, reason=one_line(str(error)))
    node.tasks = tasks
    node.use(settings)
    return SetParametersResult(successful=True)


class OperatorServices:
    """Services `~/pause`, `~/resume` and `~/plan_now` (Trigger), and `~/tasks/NAME/enable` (SetBool) of every task.

    In the names of services, what ROS does not allow in the name of a task is an underscore.
    """

    def __init__(self, node: CommandingNode) -> None:
        self._node, self._replanner = node, node.replanner
        for name, handler in (("pause", self._pause), ("resume", self._resume), ("plan_now", self._plan_now)):
            node.create_service(Trigger, f"{topics.PLANNER}/{name}", handler)
        self._tasks: dict[str, tuple[str, Any]] = {}
        self.follow_tasks()

    def follow_tasks(self) -> None:
        """Let there be a service for every task there is now."""
        for task in self._tasks.keys() - set(self._replanner.goal_names):
            self._node.destroy_service(self._tasks.pop(task)[1])
        for task in self._replanner.goal_names:
            if task not in self._tasks:
                token = service_token(task, {token for token, _ in self._tasks.values()})
                name, answer = f"{topics.PLANNER}/tasks/{token}/enable", partial(self._enable, task)
                self._tasks[task] = token, self._node.create_service(SetBool, name, answer)

    def facts(self) -> dict[str, str]:
        """Return what was asked for, for /diagnostics."""
        disabled = self._replanner.disabled
        return {f"task/{name}": "disabled" if name in disabled else "enabled" for name in self._replanner.goal_names}

    def _pause(self, request: Any, response: Any) -> Any:
        """Bring the arm to rest, and hold until `resume`."""
        with self._replanner.lock:
            response.success, response.message = True, "the arm is held; call resume to let it go on"
            if self._replanner.paused:
                response.message = "the arm was paused already"
                return response
            self._replanner.paused = PAUSED
            self._node.hold(PAUSED)
        return response

    def _resume(self, request: Any, response: Any) -> Any:
        with self._replanner.lock:
            response.success = bool(self._replanner.paused)
            self._replanner.paused = ""
        response.message = "planning goes on" if response.success else "it was not paused"
        return response

    def _plan_now(self, request: Any, response: Any) -> Any:
        """Let the next occupancy be answered with a step, due or not."""
        with self._replanner.lock:
            blocked = self._replanner.blocked
            if not (blocked or self._node.begun):
                blocked = self._node.waiting_for() or "no people's data have come yet"
            if not blocked:
                self._replanner.plan_now()
        response.success = not blocked
        response.message = f"nothing is planned: {blocked}" if blocked else "the next occupancy is planned with"
        return response

    def _enable(self, task: str, request: Any, response: Any) -> Any:
        """Let a task be worked on, or leave it alone: from the next occupancy on."""
        disabled = self._replanner.disabled - {task} if request.data else self._replanner.disabled | {task}
        self._replanner.change(disabled=disabled)
        response.success, response.message = True, f"{task} is {'enabled' if request.data else 'disabled'}"
        if len(disabled) == len(self._replanner.goal_names):
            response.message += "; no task is enabled: the arm is held"
        return response


def service_token(task: str, taken: set[str]) -> str:
    """Return how a task is called in the names of services: letters, digits and single underscores, none twice."""
    token = re.sub(r"[^A-Za-z0-9]+", "_", task)
    token = f"task_{token}" if not token[:1].isalpha() else token
    number, found = 2, token
    while found in taken:
        found, number = f"{token}_{number}", number + 1
    return found
