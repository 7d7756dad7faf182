"""Nodes that a lifecycle manager can configure, activate, deactivate and clean up, and that also run by themselves."""

from __future__ import annotations

import gc
import traceback
from collections.abc import Callable, Iterator
from itertools import chain
from typing import Any, TypeVar

import rclpy
from rcl_interfaces.msg import SetParametersResult
from rclpy.exceptions import NameValidationException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter

from humanpred_ros.errors import HumanPredError, UsageError, one_line
from humanpred_ros.nodes.parameters import RECONFIGURE, declare_setting
from humanpred_ros.settings import Settings, setting

_SUCCESS, _FAILURE, _ERROR = (
    TransitionCallbackReturn.SUCCESS,
    TransitionCallbackReturn.FAILURE,
    TransitionCallbackReturn.ERROR,
)
#: rclpy's own parameter: a clock that becomes another one in mid-run leaves no time that was taken before valid.
_SIM_TIME = "use_sim_time"


class NodeSettings(Settings):
    """Parameters of every node."""

    managed: bool = setting(
        False, "a lifecycle manager configures and activates the node; false: it does so by itself when it starts"
    )


class ManagedNode(LifecycleNode):
    """A node of four states: unconfigured, inactive (all is loaded, nothing connected), active, finalized.

    Subclasses say what the transitions do, in `configure`, `activate` and `deactivate`. What `activate` and the
    callbacks of an active node have made (publishers, subscriptions, timers, clients, services) is destroyed when it is
    deactivated, and what attributes the node has got since it was made are forgotten when it is cleaned up. So is what
    a transition that fails has made before: the node stays in the state it was in, and `failure` tells why. A
    transition that the state does not allow is refused.

    Parameters that cannot change at run time can change while the node is unconfigured: it reads them when it is
    configured.

    Attributes:
        managed: whether a manager makes the transitions.
        connected: whether it is active, or becomes so just now.
        activations: how often it was activated.
        failure: why the last transition failed, or what ended the node's work; None if nothing did.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.failure: Exception | None = None
        self.connected = self._ending = False
        self.activations = 0
        self.managed: bool = declare_setting(self, "managed", NodeSettings.model_fields["managed"])
        self.add_on_set_parameters_callback(self._on_set_parameters)
        self._change_state: Callable[[Any, Any], Any] = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state
        self._kept: set[Any] = set()
        self._own: set[str] = set()

    def configure(self) -> None:
        """Read the parameters, load, compile and check: whatever takes long. Raises HumanPredError."""

    def activate(self) -> None:
        """Connect: make what speaks and listens, and start threads. Raises HumanPredError."""

    def deactivate(self) -> None:
        """Bring to rest what the node moves, and end its threads."""

    def on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Take other values of parameters that may change at run time, all or none; called once configured."""
        return SetParametersResult(successful=True)

    def refuse(self, reason: str) -> None:
        """Note that something was refused."""
        raise NotImplementedError

    @property
    def state(self) -> str:
        """The state's name as ROS gives it."""
        name: str = self._state_machine.current_state[1]
        return name

    def start(self) -> None:
        """Configure and activate. Raises what keeps the node from it."""
        changes: tuple[Callable[[], Any], ...] = (self.trigger_configure, self.trigger_activate)
        for change in changes:
            if change() != _SUCCESS:
                assert self.failure is not None
                raise self.failure

    def close(self) -> None:
        """Release what must not be lost when the process ends; called once, whatever ended it."""
        if self.connected:
            self.connected = False
            self.deactivate()

    def end(self) -> None:
        """End the work, from any thread: the process, or where a manager has it the active state."""
        self._ending = True
        if not self.managed:
            rclpy.try_shutdown()

    def stop_with(self, error: HumanPredError) -> None:
        """End the work with this error: called from callbacks, where raising would only print a trace."""
        self.failure = error
        self.end()

    def survive(self, error: Exception) -> None:
        """Deactivate after an error that nobody foresaw; what was loaded is kept, for another try."""
        self._report(error)
        self.end()
        self.end_if_asked()

    def end_if_asked(self) -> None:
        """Deactivate after `end`; called by the executor's thread every now and then."""
        if self._ending and self.connected and self.managed:
            self.trigger_deactivate()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._own, self._kept = self._own or set(vars(self)), set(self._entities())
        return self._do(self.configure, self._forget)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._kept = set(self._entities())
        self._ending, self.connected = False, True
        done = self._do(self.activate, self.disconnect)
        # What is there now stays: looking through it for garbage would stop all threads for a tenth of a second.
        gc.unfreeze()
        gc.collect()
        gc.freeze()
        self.activations += done == _SUCCESS
        return done

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            self.deactivate()
        except Exception as error:
            self._report(error)
            return _ERROR
        self.disconnect()
        return _SUCCESS

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.failure = None
        self._forget()
        return _SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        if self.connected and self.on_deactivate(state) == _ERROR:
            return _ERROR
        self._forget()
        return _SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Go back to the beginning: after this the node is unconfigured."""
        self.disconnect()
        self._forget()
        return _SUCCESS

    def _do(self, work: Callable[[], None], undo: Callable[[], None]) -> TransitionCallbackReturn:
        self.failure = None
        try:
            work()
        except (HumanPredError, NameValidationException) as error:
            self.failure = error if isinstance(error, HumanPredError) else UsageError(str(error))
            undo()
            if self.managed:
                self.get_logger().error(one_line(str(self.failure)))
            return _FAILURE
        except Exception as error:
            self._report(error)
            return _ERROR
        return _SUCCESS

    def _report(self, error: Exception) -> None:
        self.failure = error
        if self.managed:
            self.get_logger().error("".join(traceback.format_exception(error)))

    def create_timer(self, timer_period_sec: float, callback: Any, *others: Any, **named: Any) -> Any:
        if not self.connected:
            return super().create_timer(timer_period_sec, callback, *others, **named)

        def while_connected() -> None:  # a tick may still wait when the node is deactivated
            if self.connected:
                callback()

        return super().create_timer(timer_period_sec, while_connected, *others, **named)

    def _entities(self) -> chain[Any]:
        return chain(
            self.publishers, self.subscriptions, self.timers, self.clients, self.services, self.guards, self.waitables
        )

    def disconnect(self) -> None:
        """Destroy what an active node has made."""
        self.connected = False
        made: tuple[tuple[Iterator[Any], Callable[[Any], object]], ...] = (
            (self.waitables, lambda waitable: waitable.destroy()),  # of actions; those of the others go with them
            (self.publishers, self.destroy_publisher),
            (self.subscriptions, self.destroy_subscription),
            (self.timers, self.destroy_timer),
            (self.clients, self.destroy_client),
            (self.services, self.destroy_service),
            (self.guards, self.destroy_guard_condition),
        )
        for entities, destroy in made:
            for entity in set(entities) - self._kept:
                if hasattr(entity, "destroy"):
                    destroy(entity)

    def _forget(self) -> None:
        for name in vars(self).keys() - self._own:
            delattr(self, name)

    def _on_change_state(self, request: Any, response: Any) -> Any:
        wanted = request.transition
        possible = {number: label for number, label, *_ in self._state_machine.available_transitions}
        if wanted.label in possible.values() if wanted.label else wanted.id in possible:
            return self._change_state(request, response)
        asked = wanted.label or f"number {wanted.id}"
        self.refuse(
            f"transition in the wrong state: wanted {' or '.join(sorted(set(possible.values())))}, "
            f"as the node is {self.state}; got {asked}"
        )
        response.success = False
        return response

    def _on_set_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        # Configuring declares parameters, too.
        declared = [parameter for parameter in parameters if self.has_parameter(parameter.name)]
        unconfigured = self.state == "unconfigured"
        for parameter in declared:
            # Those that may change at run time have no constraint, ROS's own clock neither.
            constraint = self.describe_parameter(parameter.name).additional_constraints
            why = RECONFIGURE if parameter.name == _SIM_TIME else constraint
            if why and not (unconfigured and why.startswith(RECONFIGURE)):
                return SetParametersResult(successful=False, reason=f"{parameter.name}: {why}")
        if unconfigured or not declared:
            return SetParametersResult(successful=True)
        return self.on_parameters(declared)


T = TypeVar("T", bound=ManagedNode)


def started(make_node: Callable[[], T]) -> T:
    """Return an active node, for programs that have it in their own process; `close` brings it to rest."""
    node = make_node()
    destroy: Callable[[], None] = node.destroy_node
    try:
        node.start()
    except BaseException:
        destroy()
        raise
    return node
