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
    WP: Step.Type
    CTRL: Step.Type
    VEL: Step.Type
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
    __slots__ = ("t", "vehicle")
    class Field(_message.Message):
        __slots__ = ("name", "value")
        NAME_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        name: str
        value: _containers.RepeatedScalarFieldContainer[float]
        def __init__(self, name: _Optional[str] = ..., value: _Optional[_Iterable[float]] = ...) -> None: ...
    class Sensor(_message.Message):
        __slots__ = ("name", "field", "reason")
        NAME_FIELD_NUMBER: _ClassVar[int]
        FIELD_FIELD_NUMBER: _ClassVar[int]
        REASON_FIELD_NUMBER: _ClassVar[int]
        name: str
        field: _containers.RepeatedCompositeFieldContainer[Readings.Field]
        reason: str
        def __init__(self, name: _Optional[str] = ..., field: _Optional[_Iterable[_Union[Readings.Field, _Mapping]]] = ..., reason: _Optional[str] = ...) -> None: ...
    class Vehicle(_message.Message):
        __slots__ = ("name", "valid", "reason", "sensor")
        NAME_FIELD_NUMBER: _ClassVar[int]
        VALID_FIELD_NUMBER: _ClassVar[int]
        REASON_FIELD_NUMBER: _ClassVar[int]
        SENSOR_FIELD_NUMBER: _ClassVar[int]
        name: str
        valid: bool
        reason: str
        sensor: _containers.RepeatedCompositeFieldContainer[Readings.Sensor]
        def __init__(self, name: _Optional[str] = ..., valid: bool = ..., reason: _Optional[str] = ..., sensor: _Optional[_Iterable[_Union[Readings.Sensor, _Mapping]]] = ...) -> None: ...
    T_FIELD_NUMBER: _ClassVar[int]
    VEHICLE_FIELD_NUMBER: _ClassVar[int]
    t: float
    vehicle: _containers.RepeatedCompositeFieldContainer[Readings.Vehicle]
    def __init__(self, t: _Optional[float] = ..., vehicle: _Optional[_Iterable[_Union[Readings.Vehicle, _Mapping]]] = ...) -> None: ...

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
    __slots__ = ("id", "scenario", "seed", "number", "agent", "axis", "period", "steps", "answer_shape", "observation", "info")
    class Axis(_message.Message):
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
    ID_FIELD_NUMBER: _ClassVar[int]
    SCENARIO_FIELD_NUMBER: _ClassVar[int]
    SEED_FIELD_NUMBER: _ClassVar[int]
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    AGENT_FIELD_NUMBER: _ClassVar[int]
    AXIS_FIELD_NUMBER: _ClassVar[int]
    PERIOD_FIELD_NUMBER: _ClassVar[int]
    STEPS_FIELD_NUMBER: _ClassVar[int]
    ANSWER_SHAPE_FIELD_NUMBER: _ClassVar[int]
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
    observation: _containers.RepeatedCompositeFieldContainer[Values]
    info: _containers.RepeatedCompositeFieldContainer[Values]
    def __init__(self, id: _Optional[int] = ..., scenario: _Optional[str] = ..., seed: _Optional[int] = ..., number: _Optional[int] = ..., agent: _Optional[_Iterable[str]] = ..., axis: _Optional[_Iterable[_Union[Episode.Axis, _Mapping]]] = ..., period: _Optional[float] = ..., steps: _Optional[int] = ..., answer_shape: _Optional[_Iterable[int]] = ..., observation: _Optional[_Iterable[_Union[Values, _Mapping]]] = ..., info: _Optional[_Iterable[_Union[Values, _Mapping]]] = ...) -> None: ...

class Act(_message.Message):
    __slots__ = ("action", "answer")
    class Answer(_message.Message):
        __slots__ = ("value",)
        VALUE_FIELD_NUMBER: _ClassVar[int]
        value: _containers.RepeatedScalarFieldContainer[float]
        def __init__(self, value: _Optional[_Iterable[float]] = ...) -> None: ...
    ACTION_FIELD_NUMBER: _ClassVar[int]
    ANSWER_FIELD_NUMBER: _ClassVar[int]
    action: _containers.RepeatedCompositeFieldContainer[Arrayd]
    answer: _containers.RepeatedCompositeFieldContainer[Act.Answer]
    def __init__(self, action: _Optional[_Iterable[_Union[Arrayd, _Mapping]]] = ..., answer: _Optional[_Iterable[_Union[Act.Answer, _Mapping]]] = ...) -> None: ...

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

class Message(_message.Message):
    __slots__ = ("type", "init", "reset", "disconnect", "setsState", "step", "state", "taskInfo", "ack", "hello", "server", "open", "session", "restart", "get_readings", "readings", "watch", "get_events", "events", "pace", "pacing", "play", "episode", "act", "outcome")
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
    def __init__(self, type: _Optional[_Union[Message.Type, str]] = ..., init: _Optional[_Union[Init, _Mapping]] = ..., reset: _Optional[_Union[Reset, _Mapping]] = ..., disconnect: _Optional[_Union[Disconnect, _Mapping]] = ..., setsState: _Optional[_Union[SetState, _Mapping]] = ..., step: _Optional[_Union[Step, _Mapping]] = ..., state: _Optional[_Union[State, _Mapping]] = ..., taskInfo: _Optional[_Union[TaskInfo, _Mapping]] = ..., ack: _Optional[_Union[Ack, _Mapping]] = ..., hello: _Optional[_Union[Hello, _Mapping]] = ..., server: _Optional[_Union[Server, _Mapping]] = ..., open: _Optional[_Union[Open, _Mapping]] = ..., session: _Optional[_Union[Session, _Mapping]] = ..., restart: _Optional[_Union[Restart, _Mapping]] = ..., get_readings: _Optional[_Union[GetReadings, _Mapping]] = ..., readings: _Optional[_Union[Readings, _Mapping]] = ..., watch: _Optional[_Union[Watch, _Mapping]] = ..., get_events: _Optional[_Union[GetEvents, _Mapping]] = ..., events: _Optional[_Union[Events, _Mapping]] = ..., pace: _Optional[_Union[Pace, _Mapping]] = ..., pacing: _Optional[_Union[Pacing, _Mapping]] = ..., play: _Optional[_Union[Play, _Mapping]] = ..., episode: _Optional[_Union[Episode, _Mapping]] = ..., act: _Optional[_Union[Act, _Mapping]] = ..., outcome: _Optional[_Union[Outcome, _Mapping]] = ...) -> None: ...
