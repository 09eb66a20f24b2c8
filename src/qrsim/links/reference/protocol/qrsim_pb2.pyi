from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Size(_message.Message):
    __slots__ = ("value",)
    VALUE_FIELD_NUMBER: _ClassVar[int]
    value: int
    def __init__(self, value: _Optional[int] = ...) -> None: ...

class Arrayd(_message.Message):
    __slots__ = ("value",)
    VALUE_FIELD_NUMBER: _ClassVar[int]
    value: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, value: _Optional[_Iterable[float]] = ...) -> None: ...

class Init(_message.Message):
    __slots__ = ("task", "realTime")
    TASK_FIELD_NUMBER: _ClassVar[int]
    REALTIME_FIELD_NUMBER: _ClassVar[int]
    task: str
    realTime: bool
    def __init__(self, task: _Optional[str] = ..., realTime: bool = ...) -> None: ...

class Reset(_message.Message):
    __slots__ = ("value",)
    VALUE_FIELD_NUMBER: _ClassVar[int]
    value: bool
    def __init__(self, value: bool = ...) -> None: ...

class Disconnect(_message.Message):
    __slots__ = ("quit",)
    QUIT_FIELD_NUMBER: _ClassVar[int]
    quit: bool
    def __init__(self, quit: bool = ...) -> None: ...

class SetState(_message.Message):
    __slots__ = ("X",)
    X_FIELD_NUMBER: _ClassVar[int]
    X: _containers.RepeatedCompositeFieldContainer[Arrayd]
    def __init__(self, X: _Optional[_Iterable[_Union[Arrayd, _Mapping]]] = ...) -> None: ...

class Step(_message.Message):
    __slots__ = ("dt", "type", "cmd")
    class Type(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        WP: _ClassVar[Step.Type]
        CTRL: _ClassVar[Step.Type]
        VEL: _ClassVar[Step.Type]
        VEL_YAW: _ClassVar[Step.Type]
        VEL_HEIGHT: _ClassVar[Step.Type]
        ATT_HEIGHT: _ClassVar[Step.Type]
        ATT: _ClassVar[Step.Type]
        PATH: _ClassVar[Step.Type]
        TRACK: _ClassVar[Step.Type]
    WP: Step.Type
    CTRL: Step.Type
    VEL: Step.Type
    VEL_YAW: Step.Type
    VEL_HEIGHT: Step.Type
    ATT_HEIGHT: Step.Type
    ATT: Step.Type
    PATH: Step.Type
    TRACK: Step.Type
    DT_FIELD_NUMBER: _ClassVar[int]
    TYPE_FIELD_NUMBER: _ClassVar[int]
    CMD_FIELD_NUMBER: _ClassVar[int]
    dt: float
    type: Step.Type
    cmd: _containers.RepeatedCompositeFieldContainer[Arrayd]
    def __init__(self, dt: _Optional[float] = ..., type: _Optional[_Union[Step.Type, str]] = ..., cmd: _Optional[_Iterable[_Union[Arrayd, _Mapping]]] = ...) -> None: ...

class State(_message.Message):
    __slots__ = ("t", "X", "eX", "reason")
    T_FIELD_NUMBER: _ClassVar[int]
    X_FIELD_NUMBER: _ClassVar[int]
    EX_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    t: float
    X: _containers.RepeatedCompositeFieldContainer[Arrayd]
    eX: _containers.RepeatedCompositeFieldContainer[Arrayd]
    reason: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, t: _Optional[float] = ..., X: _Optional[_Iterable[_Union[Arrayd, _Mapping]]] = ..., eX: _Optional[_Iterable[_Union[Arrayd, _Mapping]]] = ..., reason: _Optional[_Iterable[str]] = ...) -> None: ...

class TaskInfo(_message.Message):
    __slots__ = ("timestep", "numUAVs")
    TIMESTEP_FIELD_NUMBER: _ClassVar[int]
    NUMUAVS_FIELD_NUMBER: _ClassVar[int]
    timestep: float
    numUAVs: int
    def __init__(self, timestep: _Optional[float] = ..., numUAVs: _Optional[int] = ...) -> None: ...

class Ack(_message.Message):
    __slots__ = ("error", "msg")
    ERROR_FIELD_NUMBER: _ClassVar[int]
    MSG_FIELD_NUMBER: _ClassVar[int]
    error: bool
    msg: str
    def __init__(self, error: bool = ..., msg: _Optional[str] = ...) -> None: ...

class Hello(_message.Message):
    __slots__ = ("reasons",)
    REASONS_FIELD_NUMBER: _ClassVar[int]
    reasons: bool
    def __init__(self, reasons: bool = ...) -> None: ...

class Server(_message.Message):
    __slots__ = ("version", "capability", "task", "session", "largest_request")
    VERSION_FIELD_NUMBER: _ClassVar[int]
    CAPABILITY_FIELD_NUMBER: _ClassVar[int]
    TASK_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    LARGEST_REQUEST_FIELD_NUMBER: _ClassVar[int]
    version: str
    capability: _containers.RepeatedScalarFieldContainer[str]
    task: _containers.RepeatedScalarFieldContainer[str]
    session: _containers.RepeatedScalarFieldContainer[int]
    largest_request: int
    def __init__(self, version: _Optional[str] = ..., capability: _Optional[_Iterable[str]] = ..., task: _Optional[_Iterable[str]] = ..., session: _Optional[_Iterable[int]] = ..., largest_request: _Optional[int] = ...) -> None: ...

class Open(_message.Message):
    __slots__ = ("task", "scenario", "seed", "realtime", "events")
    TASK_FIELD_NUMBER: _ClassVar[int]
    SCENARIO_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    REALTIME_FIELD_NUMBER: _ClassVar[int]
    EVENTS_FIELD_NUMBER: _ClassVar[int]
    task: str
    scenario: str
    seed: int
    realtime: float
    events: bool
    def __init__(self, task: _Optional[str] = ..., scenario: _Optional[str] = ..., seed: _Optional[int] = ..., realtime: _Optional[float] = ..., events: bool = ...) -> None: ...

class Session(_message.Message):
    __slots__ = ("id", "scenario", "seed", "vehicle", "info", "state")
    ID_FIELD_NUMBER: _ClassVar[int]
    SCENARIO_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    VEHICLE_FIELD_NUMBER: _ClassVar[int]
    INFO_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    id: int
    scenario: str
    seed: int
    vehicle: _containers.RepeatedScalarFieldContainer[str]
    info: TaskInfo
    state: State
    def __init__(self, id: _Optional[int] = ..., scenario: _Optional[str] = ..., seed: _Optional[int] = ..., vehicle: _Optional[_Iterable[str]] = ..., info: _Optional[_Union[TaskInfo, _Mapping]] = ..., state: _Optional[_Union[State, _Mapping]] = ...) -> None: ...

class Restart(_message.Message):
    __slots__ = ("seed",)
    SEED_FIELD_NUMBER: _ClassVar[int]
    seed: int
    def __init__(self, seed: _Optional[int] = ...) -> None: ...

class GetReadings(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class Readings(_message.Message):
    __slots__ = ("t", "vehicle", "tick", "sent", "missed")
    class Field(_message.Message):
        __slots__ = ("name", "value")
        NAME_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        name: str
        value: _containers.RepeatedScalarFieldContainer[float]
        def __init__(self, name: _Optional[str] = ..., value: _Optional[_Iterable[float]] = ...) -> None: ...
    class Sensor(_message.Message):
        __slots__ = ("name", "field", "reason", "time", "fresh")
        NAME_FIELD_NUMBER: _ClassVar[int]
        FIELD_FIELD_NUMBER: _ClassVar[int]
        REASON_FIELD_NUMBER: _ClassVar[int]
        TIME_FIELD_NUMBER: _ClassVar[int]
        FRESH_FIELD_NUMBER: _ClassVar[int]
        name: str
        field: _containers.RepeatedCompositeFieldContainer[Readings.Field]
        reason: str
        time: float
        fresh: bool
        def __init__(self, name: _Optional[str] = ..., field: _Optional[_Iterable[_Union[Readings.Field, _Mapping]]] = ..., reason: _Optional[str] = ..., time: _Optional[float] = ..., fresh: bool = ...) -> None: ...
    class Heard(_message.Message):
        __slots__ = ("sender", "sent", "received", "rssi", "value")
        SENDER_FIELD_NUMBER: _ClassVar[int]
        SENT_FIELD_NUMBER: _ClassVar[int]
        RECEIVED_FIELD_NUMBER: _ClassVar[int]
        RSSI_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        sender: str
        sent: float
        received: float
        rssi: float
        value: _containers.RepeatedScalarFieldContainer[float]
        def __init__(self, sender: _Optional[str] = ..., sent: _Optional[float] = ..., received: _Optional[float] = ..., rssi: _Optional[float] = ..., value: _Optional[_Iterable[float]] = ...) -> None: ...
    class Vehicle(_message.Message):
        __slots__ = ("name", "valid", "reason", "sensor", "X", "heard")
        NAME_FIELD_NUMBER: _ClassVar[int]
        VALID_FIELD_NUMBER: _ClassVar[int]
        REASON_FIELD_NUMBER: _ClassVar[int]
        SENSOR_FIELD_NUMBER: _ClassVar[int]
        X_FIELD_NUMBER: _ClassVar[int]
        HEARD_FIELD_NUMBER: _ClassVar[int]
        name: str
        valid: bool
        reason: str
        sensor: _containers.RepeatedCompositeFieldContainer[Readings.Sensor]
        X: Arrayd
        heard: _containers.RepeatedCompositeFieldContainer[Readings.Heard]
        def __init__(self, name: _Optional[str] = ..., valid: bool = ..., reason: _Optional[str] = ..., sensor: _Optional[_Iterable[_Union[Readings.Sensor, _Mapping]]] = ..., X: _Optional[_Union[Arrayd, _Mapping]] = ..., heard: _Optional[_Iterable[_Union[Readings.Heard, _Mapping]]] = ...) -> None: ...
    T_FIELD_NUMBER: _ClassVar[int]
    VEHICLE_FIELD_NUMBER: _ClassVar[int]
    TICK_FIELD_NUMBER: _ClassVar[int]
    SENT_FIELD_NUMBER: _ClassVar[int]
    MISSED_FIELD_NUMBER: _ClassVar[int]
    t: float
    vehicle: _containers.RepeatedCompositeFieldContainer[Readings.Vehicle]
    tick: int
    sent: float
    missed: int
    def __init__(self, t: _Optional[float] = ..., vehicle: _Optional[_Iterable[_Union[Readings.Vehicle, _Mapping]]] = ..., tick: _Optional[int] = ..., sent: _Optional[float] = ..., missed: _Optional[int] = ...) -> None: ...

class Watch(_message.Message):
    __slots__ = ("session", "period", "stop")
    SESSION_FIELD_NUMBER: _ClassVar[int]
    PERIOD_FIELD_NUMBER: _ClassVar[int]
    STOP_FIELD_NUMBER: _ClassVar[int]
    session: int
    period: float
    stop: bool
    def __init__(self, session: _Optional[int] = ..., period: _Optional[float] = ..., stop: bool = ...) -> None: ...

class GetEvents(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class Events(_message.Message):
    __slots__ = ("event", "lost")
    class Event(_message.Message):
        __slots__ = ("t", "kind", "vehicle", "field", "value", "message")
        T_FIELD_NUMBER: _ClassVar[int]
        KIND_FIELD_NUMBER: _ClassVar[int]
        VEHICLE_FIELD_NUMBER: _ClassVar[int]
        FIELD_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        MESSAGE_FIELD_NUMBER: _ClassVar[int]
        t: float
        kind: str
        vehicle: str
        field: str
        value: float
        message: str
        def __init__(self, t: _Optional[float] = ..., kind: _Optional[str] = ..., vehicle: _Optional[str] = ..., field: _Optional[str] = ..., value: _Optional[float] = ..., message: _Optional[str] = ...) -> None: ...
    EVENT_FIELD_NUMBER: _ClassVar[int]
    LOST_FIELD_NUMBER: _ClassVar[int]
    event: _containers.RepeatedCompositeFieldContainer[Events.Event]
    lost: int
    def __init__(self, event: _Optional[_Iterable[_Union[Events.Event, _Mapping]]] = ..., lost: _Optional[int] = ...) -> None: ...

class Pace(_message.Message):
    __slots__ = ("factor",)
    FACTOR_FIELD_NUMBER: _ClassVar[int]
    factor: float
    def __init__(self, factor: _Optional[float] = ...) -> None: ...

class Pacing(_message.Message):
    __slots__ = ("factor", "steps", "overruns", "worst_delay", "simulated", "wall")
    FACTOR_FIELD_NUMBER: _ClassVar[int]
    STEPS_FIELD_NUMBER: _ClassVar[int]
    OVERRUNS_FIELD_NUMBER: _ClassVar[int]
    WORST_DELAY_FIELD_NUMBER: _ClassVar[int]
    SIMULATED_FIELD_NUMBER: _ClassVar[int]
    WALL_FIELD_NUMBER: _ClassVar[int]
    factor: float
    steps: int
    overruns: int
    worst_delay: float
    simulated: float
    wall: float
    def __init__(self, factor: _Optional[float] = ..., steps: _Optional[int] = ..., overruns: _Optional[int] = ..., worst_delay: _Optional[float] = ..., simulated: _Optional[float] = ..., wall: _Optional[float] = ...) -> None: ...

class Play(_message.Message):
    __slots__ = ("task", "scenario", "seed")
    TASK_FIELD_NUMBER: _ClassVar[int]
    SCENARIO_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    task: str
    scenario: str
    seed: int
    def __init__(self, task: _Optional[str] = ..., scenario: _Optional[str] = ..., seed: _Optional[int] = ...) -> None: ...

class Values(_message.Message):
    __slots__ = ("name", "shape", "value")
    NAME_FIELD_NUMBER: _ClassVar[int]
    SHAPE_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    name: str
    shape: _containers.RepeatedScalarFieldContainer[int]
    value: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, name: _Optional[str] = ..., shape: _Optional[_Iterable[int]] = ..., value: _Optional[_Iterable[float]] = ...) -> None: ...

class Episode(_message.Message):
    __slots__ = ("id", "scenario", "seed", "number", "agent", "axis", "period", "steps", "answer_shape", "say_size", "observation", "info")
    class Axis(_message.Message):
        __slots__ = ("name", "unit", "low", "high", "neutral")
        NAME_FIELD_NUMBER: _ClassVar[int]
        UNIT_FIELD_NUMBER: _ClassVar[int]
        LOW_FIELD_NUMBER: _ClassVar[int]
        HIGH_FIELD_NUMBER: _ClassVar[int]
        NEUTRAL_FIELD_NUMBER: _ClassVar[int]
        name: str
        unit: str
        low: float
        high: float
        neutral: float
        def __init__(self, name: _Optional[str] = ..., unit: _Optional[str] = ..., low: _Optional[float] = ..., high: _Optional[float] = ..., neutral: _Optional[float] = ...) -> None: ...
    ID_FIELD_NUMBER: _ClassVar[int]
    SCENARIO_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    AGENT_FIELD_NUMBER: _ClassVar[int]
    AXIS_FIELD_NUMBER: _ClassVar[int]
    PERIOD_FIELD_NUMBER: _ClassVar[int]
    STEPS_FIELD_NUMBER: _ClassVar[int]
    ANSWER_SHAPE_FIELD_NUMBER: _ClassVar[int]
    SAY_SIZE_FIELD_NUMBER: _ClassVar[int]
    OBSERVATION_FIELD_NUMBER: _ClassVar[int]
    INFO_FIELD_NUMBER: _ClassVar[int]
    id: int
    scenario: str
    seed: int
    number: int
    agent: _containers.RepeatedScalarFieldContainer[str]
    axis: _containers.RepeatedCompositeFieldContainer[Episode.Axis]
    period: float
    steps: int
    answer_shape: _containers.RepeatedScalarFieldContainer[int]
    say_size: int
    observation: _containers.RepeatedCompositeFieldContainer[Values]
    info: _containers.RepeatedCompositeFieldContainer[Values]
    def __init__(self, id: _Optional[int] = ..., scenario: _Optional[str] = ..., seed: _Optional[int] = ..., number: _Optional[int] = ..., agent: _Optional[_Iterable[str]] = ..., axis: _Optional[_Iterable[_Union[Episode.Axis, _Mapping]]] = ..., period: _Optional[float] = ..., steps: _Optional[int] = ..., answer_shape: _Optional[_Iterable[int]] = ..., say_size: _Optional[int] = ..., observation: _Optional[_Iterable[_Union[Values, _Mapping]]] = ..., info: _Optional[_Iterable[_Union[Values, _Mapping]]] = ...) -> None: ...

class Act(_message.Message):
    __slots__ = ("action", "answer", "say")
    class Answer(_message.Message):
        __slots__ = ("value",)
        VALUE_FIELD_NUMBER: _ClassVar[int]
        value: _containers.RepeatedScalarFieldContainer[float]
        def __init__(self, value: _Optional[_Iterable[float]] = ...) -> None: ...
    ACTION_FIELD_NUMBER: _ClassVar[int]
    ANSWER_FIELD_NUMBER: _ClassVar[int]
    SAY_FIELD_NUMBER: _ClassVar[int]
    action: _containers.RepeatedCompositeFieldContainer[Arrayd]
    answer: _containers.RepeatedCompositeFieldContainer[Act.Answer]
    say: _containers.RepeatedCompositeFieldContainer[Arrayd]
    def __init__(self, action: _Optional[_Iterable[_Union[Arrayd, _Mapping]]] = ..., answer: _Optional[_Iterable[_Union[Act.Answer, _Mapping]]] = ..., say: _Optional[_Iterable[_Union[Arrayd, _Mapping]]] = ...) -> None: ...

class Outcome(_message.Message):
    __slots__ = ("step", "t", "observation", "reward", "terminated", "truncated", "info")
    STEP_FIELD_NUMBER: _ClassVar[int]
    T_FIELD_NUMBER: _ClassVar[int]
    OBSERVATION_FIELD_NUMBER: _ClassVar[int]
    REWARD_FIELD_NUMBER: _ClassVar[int]
    TERMINATED_FIELD_NUMBER: _ClassVar[int]
    TRUNCATED_FIELD_NUMBER: _ClassVar[int]
    INFO_FIELD_NUMBER: _ClassVar[int]
    step: int
    t: float
    observation: _containers.RepeatedCompositeFieldContainer[Values]
    reward: _containers.RepeatedScalarFieldContainer[float]
    terminated: bool
    truncated: bool
    info: _containers.RepeatedCompositeFieldContainer[Values]
    def __init__(self, step: _Optional[int] = ..., t: _Optional[float] = ..., observation: _Optional[_Iterable[_Union[Values, _Mapping]]] = ..., reward: _Optional[_Iterable[float]] = ..., terminated: bool = ..., truncated: bool = ..., info: _Optional[_Iterable[_Union[Values, _Mapping]]] = ...) -> None: ...

class Claim(_message.Message):
    __slots__ = ("vehicle", "on_silence", "hold")
    VEHICLE_FIELD_NUMBER: _ClassVar[int]
    ON_SILENCE_FIELD_NUMBER: _ClassVar[int]
    HOLD_FIELD_NUMBER: _ClassVar[int]
    vehicle: _containers.RepeatedScalarFieldContainer[str]
    on_silence: str
    hold: float
    def __init__(self, vehicle: _Optional[_Iterable[str]] = ..., on_silence: _Optional[str] = ..., hold: _Optional[float] = ...) -> None: ...

class Claimed(_message.Message):
    __slots__ = ("client", "vehicle", "scenario", "seed", "pace", "factor", "time_step", "tick", "on_silence", "hold")
    CLIENT_FIELD_NUMBER: _ClassVar[int]
    VEHICLE_FIELD_NUMBER: _ClassVar[int]
    SCENARIO_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    PACE_FIELD_NUMBER: _ClassVar[int]
    FACTOR_FIELD_NUMBER: _ClassVar[int]
    TIME_STEP_FIELD_NUMBER: _ClassVar[int]
    TICK_FIELD_NUMBER: _ClassVar[int]
    ON_SILENCE_FIELD_NUMBER: _ClassVar[int]
    HOLD_FIELD_NUMBER: _ClassVar[int]
    client: int
    vehicle: _containers.RepeatedScalarFieldContainer[str]
    scenario: str
    seed: int
    pace: str
    factor: float
    time_step: float
    tick: int
    on_silence: str
    hold: float
    def __init__(self, client: _Optional[int] = ..., vehicle: _Optional[_Iterable[str]] = ..., scenario: _Optional[str] = ..., seed: _Optional[int] = ..., pace: _Optional[str] = ..., factor: _Optional[float] = ..., time_step: _Optional[float] = ..., tick: _Optional[int] = ..., on_silence: _Optional[str] = ..., hold: _Optional[float] = ...) -> None: ...

class Release(_message.Message):
    __slots__ = ("vehicle",)
    VEHICLE_FIELD_NUMBER: _ClassVar[int]
    vehicle: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, vehicle: _Optional[_Iterable[str]] = ...) -> None: ...

class Order(_message.Message):
    __slots__ = ("vehicle", "type", "cmd")
    VEHICLE_FIELD_NUMBER: _ClassVar[int]
    TYPE_FIELD_NUMBER: _ClassVar[int]
    CMD_FIELD_NUMBER: _ClassVar[int]
    vehicle: str
    type: Step.Type
    cmd: Arrayd
    def __init__(self, vehicle: _Optional[str] = ..., type: _Optional[_Union[Step.Type, str]] = ..., cmd: _Optional[_Union[Arrayd, _Mapping]] = ...) -> None: ...

class Command(_message.Message):
    __slots__ = ("order", "computed_from", "until_tick", "ticks", "truth")
    ORDER_FIELD_NUMBER: _ClassVar[int]
    COMPUTED_FROM_FIELD_NUMBER: _ClassVar[int]
    UNTIL_TICK_FIELD_NUMBER: _ClassVar[int]
    TICKS_FIELD_NUMBER: _ClassVar[int]
    TRUTH_FIELD_NUMBER: _ClassVar[int]
    order: _containers.RepeatedCompositeFieldContainer[Order]
    computed_from: int
    until_tick: int
    ticks: int
    truth: bool
    def __init__(self, order: _Optional[_Iterable[_Union[Order, _Mapping]]] = ..., computed_from: _Optional[int] = ..., until_tick: _Optional[int] = ..., ticks: _Optional[int] = ..., truth: bool = ...) -> None: ...

class Commanded(_message.Message):
    __slots__ = ("tick",)
    TICK_FIELD_NUMBER: _ClassVar[int]
    tick: int
    def __init__(self, tick: _Optional[int] = ...) -> None: ...

class Subscribe(_message.Message):
    __slots__ = ("vehicle", "rate", "truth", "stop")
    VEHICLE_FIELD_NUMBER: _ClassVar[int]
    RATE_FIELD_NUMBER: _ClassVar[int]
    TRUTH_FIELD_NUMBER: _ClassVar[int]
    STOP_FIELD_NUMBER: _ClassVar[int]
    vehicle: _containers.RepeatedScalarFieldContainer[str]
    rate: float
    truth: bool
    stop: bool
    def __init__(self, vehicle: _Optional[_Iterable[str]] = ..., rate: _Optional[float] = ..., truth: bool = ..., stop: bool = ...) -> None: ...

class GetStatus(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class Status(_message.Message):
    __slots__ = ("pace", "tick", "t", "pacing", "vehicle")
    class Vehicle(_message.Message):
        __slots__ = ("name", "client", "flies", "source_tick", "arrival_tick", "age", "misses", "silent_since")
        NAME_FIELD_NUMBER: _ClassVar[int]
        CLIENT_FIELD_NUMBER: _ClassVar[int]
        FLIES_FIELD_NUMBER: _ClassVar[int]
        SOURCE_TICK_FIELD_NUMBER: _ClassVar[int]
        ARRIVAL_TICK_FIELD_NUMBER: _ClassVar[int]
        AGE_FIELD_NUMBER: _ClassVar[int]
        MISSES_FIELD_NUMBER: _ClassVar[int]
        SILENT_SINCE_FIELD_NUMBER: _ClassVar[int]
        name: str
        client: int
        flies: str
        source_tick: int
        arrival_tick: int
        age: float
        misses: int
        silent_since: float
        def __init__(self, name: _Optional[str] = ..., client: _Optional[int] = ..., flies: _Optional[str] = ..., source_tick: _Optional[int] = ..., arrival_tick: _Optional[int] = ..., age: _Optional[float] = ..., misses: _Optional[int] = ..., silent_since: _Optional[float] = ...) -> None: ...
    PACE_FIELD_NUMBER: _ClassVar[int]
    TICK_FIELD_NUMBER: _ClassVar[int]
    T_FIELD_NUMBER: _ClassVar[int]
    PACING_FIELD_NUMBER: _ClassVar[int]
    VEHICLE_FIELD_NUMBER: _ClassVar[int]
    pace: str
    tick: int
    t: float
    pacing: Pacing
    vehicle: _containers.RepeatedCompositeFieldContainer[Status.Vehicle]
    def __init__(self, pace: _Optional[str] = ..., tick: _Optional[int] = ..., t: _Optional[float] = ..., pacing: _Optional[_Union[Pacing, _Mapping]] = ..., vehicle: _Optional[_Iterable[_Union[Status.Vehicle, _Mapping]]] = ...) -> None: ...

class Describe(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class World(_message.Message):
    __slots__ = ("scenario", "time_step", "collision_distance", "area", "obstacle", "ground", "wind", "turbulence", "gust", "fleet", "radio", "origin")
    class Quantity(_message.Message):
        __slots__ = ("name", "unit", "value", "text")
        NAME_FIELD_NUMBER: _ClassVar[int]
        UNIT_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        TEXT_FIELD_NUMBER: _ClassVar[int]
        name: str
        unit: str
        value: _containers.RepeatedScalarFieldContainer[float]
        text: str
        def __init__(self, name: _Optional[str] = ..., unit: _Optional[str] = ..., value: _Optional[_Iterable[float]] = ..., text: _Optional[str] = ...) -> None: ...
    class Part(_message.Message):
        __slots__ = ("type", "quantity")
        TYPE_FIELD_NUMBER: _ClassVar[int]
        QUANTITY_FIELD_NUMBER: _ClassVar[int]
        type: str
        quantity: _containers.RepeatedCompositeFieldContainer[World.Quantity]
        def __init__(self, type: _Optional[str] = ..., quantity: _Optional[_Iterable[_Union[World.Quantity, _Mapping]]] = ...) -> None: ...
    class Sensor(_message.Message):
        __slots__ = ("name", "type", "period", "field")
        NAME_FIELD_NUMBER: _ClassVar[int]
        TYPE_FIELD_NUMBER: _ClassVar[int]
        PERIOD_FIELD_NUMBER: _ClassVar[int]
        FIELD_FIELD_NUMBER: _ClassVar[int]
        name: str
        type: str
        period: float
        field: _containers.RepeatedScalarFieldContainer[str]
        def __init__(self, name: _Optional[str] = ..., type: _Optional[str] = ..., period: _Optional[float] = ..., field: _Optional[_Iterable[str]] = ...) -> None: ...
    class Command(_message.Message):
        __slots__ = ("type", "name", "field")
        class Field(_message.Message):
            __slots__ = ("name", "unit", "low", "high")
            NAME_FIELD_NUMBER: _ClassVar[int]
            UNIT_FIELD_NUMBER: _ClassVar[int]
            LOW_FIELD_NUMBER: _ClassVar[int]
            HIGH_FIELD_NUMBER: _ClassVar[int]
            name: str
            unit: str
            low: float
            high: float
            def __init__(self, name: _Optional[str] = ..., unit: _Optional[str] = ..., low: _Optional[float] = ..., high: _Optional[float] = ...) -> None: ...
        TYPE_FIELD_NUMBER: _ClassVar[int]
        NAME_FIELD_NUMBER: _ClassVar[int]
        FIELD_FIELD_NUMBER: _ClassVar[int]
        type: Step.Type
        name: str
        field: _containers.RepeatedCompositeFieldContainer[World.Command.Field]
        def __init__(self, type: _Optional[_Union[Step.Type, str]] = ..., name: _Optional[str] = ..., field: _Optional[_Iterable[_Union[World.Command.Field, _Mapping]]] = ...) -> None: ...
    class Fleet(_message.Message):
        __slots__ = ("name", "vehicle", "model", "controller", "guidance", "radius", "limits", "sensor", "command", "start")
        NAME_FIELD_NUMBER: _ClassVar[int]
        VEHICLE_FIELD_NUMBER: _ClassVar[int]
        MODEL_FIELD_NUMBER: _ClassVar[int]
        CONTROLLER_FIELD_NUMBER: _ClassVar[int]
        GUIDANCE_FIELD_NUMBER: _ClassVar[int]
        RADIUS_FIELD_NUMBER: _ClassVar[int]
        LIMITS_FIELD_NUMBER: _ClassVar[int]
        SENSOR_FIELD_NUMBER: _ClassVar[int]
        COMMAND_FIELD_NUMBER: _ClassVar[int]
        START_FIELD_NUMBER: _ClassVar[int]
        name: str
        vehicle: _containers.RepeatedScalarFieldContainer[str]
        model: World.Part
        controller: str
        guidance: str
        radius: float
        limits: World.Part
        sensor: _containers.RepeatedCompositeFieldContainer[World.Sensor]
        command: _containers.RepeatedCompositeFieldContainer[World.Command]
        start: _containers.RepeatedCompositeFieldContainer[Arrayd]
        def __init__(self, name: _Optional[str] = ..., vehicle: _Optional[_Iterable[str]] = ..., model: _Optional[_Union[World.Part, _Mapping]] = ..., controller: _Optional[str] = ..., guidance: _Optional[str] = ..., radius: _Optional[float] = ..., limits: _Optional[_Union[World.Part, _Mapping]] = ..., sensor: _Optional[_Iterable[_Union[World.Sensor, _Mapping]]] = ..., command: _Optional[_Iterable[_Union[World.Command, _Mapping]]] = ..., start: _Optional[_Iterable[_Union[Arrayd, _Mapping]]] = ...) -> None: ...
    SCENARIO_FIELD_NUMBER: _ClassVar[int]
    TIME_STEP_FIELD_NUMBER: _ClassVar[int]
    COLLISION_DISTANCE_FIELD_NUMBER: _ClassVar[int]
    AREA_FIELD_NUMBER: _ClassVar[int]
    OBSTACLE_FIELD_NUMBER: _ClassVar[int]
    GROUND_FIELD_NUMBER: _ClassVar[int]
    WIND_FIELD_NUMBER: _ClassVar[int]
    TURBULENCE_FIELD_NUMBER: _ClassVar[int]
    GUST_FIELD_NUMBER: _ClassVar[int]
    FLEET_FIELD_NUMBER: _ClassVar[int]
    RADIO_FIELD_NUMBER: _ClassVar[int]
    ORIGIN_FIELD_NUMBER: _ClassVar[int]
    scenario: str
    time_step: float
    collision_distance: float
    area: World.Part
    obstacle: _containers.RepeatedCompositeFieldContainer[World.Part]
    ground: World.Part
    wind: World.Part
    turbulence: World.Part
    gust: World.Part
    fleet: _containers.RepeatedCompositeFieldContainer[World.Fleet]
    radio: World.Part
    origin: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, scenario: _Optional[str] = ..., time_step: _Optional[float] = ..., collision_distance: _Optional[float] = ..., area: _Optional[_Union[World.Part, _Mapping]] = ..., obstacle: _Optional[_Iterable[_Union[World.Part, _Mapping]]] = ..., ground: _Optional[_Union[World.Part, _Mapping]] = ..., wind: _Optional[_Union[World.Part, _Mapping]] = ..., turbulence: _Optional[_Union[World.Part, _Mapping]] = ..., gust: _Optional[_Union[World.Part, _Mapping]] = ..., fleet: _Optional[_Iterable[_Union[World.Fleet, _Mapping]]] = ..., radio: _Optional[_Union[World.Part, _Mapping]] = ..., origin: _Optional[_Iterable[float]] = ...) -> None: ...

class Say(_message.Message):
    __slots__ = ("words",)
    class Words(_message.Message):
        __slots__ = ("vehicle", "value", "to")
        VEHICLE_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        TO_FIELD_NUMBER: _ClassVar[int]
        vehicle: str
        value: _containers.RepeatedScalarFieldContainer[float]
        to: str
        def __init__(self, vehicle: _Optional[str] = ..., value: _Optional[_Iterable[float]] = ..., to: _Optional[str] = ...) -> None: ...
    WORDS_FIELD_NUMBER: _ClassVar[int]
    words: _containers.RepeatedCompositeFieldContainer[Say.Words]
    def __init__(self, words: _Optional[_Iterable[_Union[Say.Words, _Mapping]]] = ...) -> None: ...

class Inject(_message.Message):
    __slots__ = ("target", "kind", "vehicle", "number", "field", "at", "duration")
    class Number(_message.Message):
        __slots__ = ("name", "value")
        NAME_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        name: str
        value: float
        def __init__(self, name: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    TARGET_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    VEHICLE_FIELD_NUMBER: _ClassVar[int]
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    FIELD_FIELD_NUMBER: _ClassVar[int]
    AT_FIELD_NUMBER: _ClassVar[int]
    DURATION_FIELD_NUMBER: _ClassVar[int]
    target: str
    kind: str
    vehicle: _containers.RepeatedScalarFieldContainer[str]
    number: _containers.RepeatedCompositeFieldContainer[Inject.Number]
    field: str
    at: float
    duration: float
    def __init__(self, target: _Optional[str] = ..., kind: _Optional[str] = ..., vehicle: _Optional[_Iterable[str]] = ..., number: _Optional[_Iterable[_Union[Inject.Number, _Mapping]]] = ..., field: _Optional[str] = ..., at: _Optional[float] = ..., duration: _Optional[float] = ...) -> None: ...

class ClearFaults(_message.Message):
    __slots__ = ("target", "vehicle")
    TARGET_FIELD_NUMBER: _ClassVar[int]
    VEHICLE_FIELD_NUMBER: _ClassVar[int]
    target: str
    vehicle: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, target: _Optional[str] = ..., vehicle: _Optional[_Iterable[str]] = ...) -> None: ...

class Message(_message.Message):
    __slots__ = ("type", "init", "reset", "disconnect", "setsState", "step", "state", "taskInfo", "ack", "hello", "server", "open", "session", "restart", "get_readings", "readings", "watch", "get_events", "events", "pace", "pacing", "play", "episode", "act", "outcome", "claim", "claimed", "release", "command", "commanded", "subscribe", "sensed", "get_status", "status", "describe", "world", "say", "inject", "clear")
    class Type(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        NONE: _ClassVar[Message.Type]
        INIT: _ClassVar[Message.Type]
        RESET: _ClassVar[Message.Type]
        DISCONNECT: _ClassVar[Message.Type]
        SETSTATE: _ClassVar[Message.Type]
        STEP: _ClassVar[Message.Type]
        STATE: _ClassVar[Message.Type]
        TASKINFO: _ClassVar[Message.Type]
        ACK: _ClassVar[Message.Type]
        HELLO: _ClassVar[Message.Type]
        SERVER: _ClassVar[Message.Type]
        OPEN: _ClassVar[Message.Type]
        SESSION: _ClassVar[Message.Type]
        RESTART: _ClassVar[Message.Type]
        GET_READINGS: _ClassVar[Message.Type]
        READINGS: _ClassVar[Message.Type]
        WATCH: _ClassVar[Message.Type]
        GET_EVENTS: _ClassVar[Message.Type]
        EVENTS: _ClassVar[Message.Type]
        PACE: _ClassVar[Message.Type]
        PACING: _ClassVar[Message.Type]
        PLAY: _ClassVar[Message.Type]
        EPISODE: _ClassVar[Message.Type]
        ACT: _ClassVar[Message.Type]
        OUTCOME: _ClassVar[Message.Type]
        CLAIM: _ClassVar[Message.Type]
        CLAIMED: _ClassVar[Message.Type]
        RELEASE: _ClassVar[Message.Type]
        COMMAND: _ClassVar[Message.Type]
        COMMANDED: _ClassVar[Message.Type]
        SUBSCRIBE: _ClassVar[Message.Type]
        SENSED: _ClassVar[Message.Type]
        GET_STATUS: _ClassVar[Message.Type]
        STATUS: _ClassVar[Message.Type]
        DESCRIBE: _ClassVar[Message.Type]
        WORLD: _ClassVar[Message.Type]
        SAY: _ClassVar[Message.Type]
        INJECT: _ClassVar[Message.Type]
        CLEAR: _ClassVar[Message.Type]
    NONE: Message.Type
    INIT: Message.Type
    RESET: Message.Type
    DISCONNECT: Message.Type
    SETSTATE: Message.Type
    STEP: Message.Type
    STATE: Message.Type
    TASKINFO: Message.Type
    ACK: Message.Type
    HELLO: Message.Type
    SERVER: Message.Type
    OPEN: Message.Type
    SESSION: Message.Type
    RESTART: Message.Type
    GET_READINGS: Message.Type
    READINGS: Message.Type
    WATCH: Message.Type
    GET_EVENTS: Message.Type
    EVENTS: Message.Type
    PACE: Message.Type
    PACING: Message.Type
    PLAY: Message.Type
    EPISODE: Message.Type
    ACT: Message.Type
    OUTCOME: Message.Type
    CLAIM: Message.Type
    CLAIMED: Message.Type
    RELEASE: Message.Type
    COMMAND: Message.Type
    COMMANDED: Message.Type
    SUBSCRIBE: Message.Type
    SENSED: Message.Type
    GET_STATUS: Message.Type
    STATUS: Message.Type
    DESCRIBE: Message.Type
    WORLD: Message.Type
    SAY: Message.Type
    INJECT: Message.Type
    CLEAR: Message.Type
    TYPE_FIELD_NUMBER: _ClassVar[int]
    INIT_FIELD_NUMBER: _ClassVar[int]
    RESET_FIELD_NUMBER: _ClassVar[int]
    DISCONNECT_FIELD_NUMBER: _ClassVar[int]
    SETSSTATE_FIELD_NUMBER: _ClassVar[int]
    STEP_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    TASKINFO_FIELD_NUMBER: _ClassVar[int]
    ACK_FIELD_NUMBER: _ClassVar[int]
    HELLO_FIELD_NUMBER: _ClassVar[int]
    SERVER_FIELD_NUMBER: _ClassVar[int]
    OPEN_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    RESTART_FIELD_NUMBER: _ClassVar[int]
    GET_READINGS_FIELD_NUMBER: _ClassVar[int]
    READINGS_FIELD_NUMBER: _ClassVar[int]
    WATCH_FIELD_NUMBER: _ClassVar[int]
    GET_EVENTS_FIELD_NUMBER: _ClassVar[int]
    EVENTS_FIELD_NUMBER: _ClassVar[int]
    PACE_FIELD_NUMBER: _ClassVar[int]
    PACING_FIELD_NUMBER: _ClassVar[int]
    PLAY_FIELD_NUMBER: _ClassVar[int]
    EPISODE_FIELD_NUMBER: _ClassVar[int]
    ACT_FIELD_NUMBER: _ClassVar[int]
    OUTCOME_FIELD_NUMBER: _ClassVar[int]
    CLAIM_FIELD_NUMBER: _ClassVar[int]
    CLAIMED_FIELD_NUMBER: _ClassVar[int]
    RELEASE_FIELD_NUMBER: _ClassVar[int]
    COMMAND_FIELD_NUMBER: _ClassVar[int]
    COMMANDED_FIELD_NUMBER: _ClassVar[int]
    SUBSCRIBE_FIELD_NUMBER: _ClassVar[int]
    SENSED_FIELD_NUMBER: _ClassVar[int]
    GET_STATUS_FIELD_NUMBER: _ClassVar[int]
    STATUS_FIELD_NUMBER: _ClassVar[int]
    DESCRIBE_FIELD_NUMBER: _ClassVar[int]
    WORLD_FIELD_NUMBER: _ClassVar[int]
    SAY_FIELD_NUMBER: _ClassVar[int]
    INJECT_FIELD_NUMBER: _ClassVar[int]
    CLEAR_FIELD_NUMBER: _ClassVar[int]
    type: Message.Type
    init: Init
    reset: Reset
    disconnect: Disconnect
    setsState: SetState
    step: Step
    state: State
    taskInfo: TaskInfo
    ack: Ack
    hello: Hello
    server: Server
    open: Open
    session: Session
    restart: Restart
    get_readings: GetReadings
    readings: Readings
    watch: Watch
    get_events: GetEvents
    events: Events
    pace: Pace
    pacing: Pacing
    play: Play
    episode: Episode
    act: Act
    outcome: Outcome
    claim: Claim
    claimed: Claimed
    release: Release
    command: Command
    commanded: Commanded
    subscribe: Subscribe
    sensed: Readings
    get_status: GetStatus
    status: Status
    describe: Describe
    world: World
    say: Say
    inject: Inject
    clear: ClearFaults
    def __init__(self, type: _Optional[_Union[Message.Type, str]] = ..., init: _Optional[_Union[Init, _Mapping]] = ..., reset: _Optional[_Union[Reset, _Mapping]] = ..., disconnect: _Optional[_Union[Disconnect, _Mapping]] = ..., setsState: _Optional[_Union[SetState, _Mapping]] = ..., step: _Optional[_Union[Step, _Mapping]] = ..., state: _Optional[_Union[State, _Mapping]] = ..., taskInfo: _Optional[_Union[TaskInfo, _Mapping]] = ..., ack: _Optional[_Union[Ack, _Mapping]] = ..., hello: _Optional[_Union[Hello, _Mapping]] = ..., server: _Optional[_Union[Server, _Mapping]] = ..., open: _Optional[_Union[Open, _Mapping]] = ..., session: _Optional[_Union[Session, _Mapping]] = ..., restart: _Optional[_Union[Restart, _Mapping]] = ..., get_readings: _Optional[_Union[GetReadings, _Mapping]] = ..., readings: _Optional[_Union[Readings, _Mapping]] = ..., watch: _Optional[_Union[Watch, _Mapping]] = ..., get_events: _Optional[_Union[GetEvents, _Mapping]] = ..., events: _Optional[_Union[Events, _Mapping]] = ..., pace: _Optional[_Union[Pace, _Mapping]] = ..., pacing: _Optional[_Union[Pacing, _Mapping]] = ..., play: _Optional[_Union[Play, _Mapping]] = ..., episode: _Optional[_Union[Episode, _Mapping]] = ..., act: _Optional[_Union[Act, _Mapping]] = ..., outcome: _Optional[_Union[Outcome, _Mapping]] = ..., claim: _Optional[_Union[Claim, _Mapping]] = ..., claimed: _Optional[_Union[Claimed, _Mapping]] = ..., release: _Optional[_Union[Release, _Mapping]] = ..., command: _Optional[_Union[Command, _Mapping]] = ..., commanded: _Optional[_Union[Commanded, _Mapping]] = ..., subscribe: _Optional[_Union[Subscribe, _Mapping]] = ..., sensed: _Optional[_Union[Readings, _Mapping]] = ..., get_status: _Optional[_Union[GetStatus, _Mapping]] = ..., status: _Optional[_Union[Status, _Mapping]] = ..., describe: _Optional[_Union[Describe, _Mapping]] = ..., world: _Optional[_Union[World, _Mapping]] = ..., say: _Optional[_Union[Say, _Mapping]] = ..., inject: _Optional[_Union[Inject, _Mapping]] = ..., clear: _Optional[_Union[ClearFaults, _Mapping]] = ...) -> None: ...
