// A client of `qrsim serve`, in one header: C++17, POSIX sockets, and the classes that protoc makes of qrsim.proto.
//
//   qrsim::Client client("127.0.0.1", 10000);
//   qrsim::State state = client.init("free_flight");
//   state = client.step_waypoint(1.0, {{8.0, -6.0, -10.0, 0.0}});   // x, y, z NED [m], yaw [rad]; one for each vehicle
//
// Every call sends one request and waits for its reply. What goes wrong is thrown, see the classes of errors. A client is
// for one thread at a time. README.md beside this file says how it is built.
#pragma once

#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "qrsim.pb.h"

namespace qrsim {

namespace pb = ::qrsimsrvcli;

// The base of every error of this client.
struct Error : std::runtime_error {
  using std::runtime_error::runtime_error;
};
// The server cannot be reached, has gone, did not answer in time, or answered nonsense; the client is closed.
struct ConnectionFailed : Error {
  using Error::Error;
};
// The server said no; the message says why. Nothing has changed.
struct Refused : Error {
  using Error::Error;
};
// After the step a vehicle is invalid; reset or set_state make it fly again.
struct InvalidState : Refused {
  using Refused::Refused;
};

// A row of numbers for each vehicle.
using Rows = std::vector<std::vector<double>>;

// What the server says of n vehicles.
struct State {
  double time = 0.0;  // simulated [s]
  // True position NED [m], Euler angles [rad], body velocity [m/s], body rates [rad/s], thrust [N].
  std::vector<std::array<double, 13>> state;
  // GNSS position; Euler angles; 0, 0, 0; body rates; 0; specific force; barometric height; GNSS velocity north, east;
  // height rate. Heights are positive up; NaN where there is no reading.
  std::vector<std::array<double, 20>> measured;
  // Why each vehicle is invalid, "" where it flies; empty where hello was not called.
  std::vector<std::string> reasons;
};

// A session opened by open, or an episode begun by restart.
struct Session {
  std::uint32_t number = 0;  // for those who want to watch it
  std::string scenario;
  std::uint64_t seed = 0;  // of this episode, which flies it again
  std::vector<std::string> vehicles;
  double time_step = 0.0;  // [s]
  State state;
};

// What open may be asked for; a scenario is YAML text, in place of a task.
struct SessionOptions {
  std::optional<std::string> task, scenario;
  std::optional<std::uint64_t> seed;
  std::optional<double> realtime;  // simulated seconds per second of the wall clock; 0: lock-step
  bool events = false;
};

// vehicle -> sensor -> field -> numbers. A field of a sensor without a reading is NaN.
using Readings = std::map<std::string, std::map<std::string, std::map<std::string, std::vector<double>>>>;

// What a vehicle is to do until its next order, in a world that several clients share. kind is WP (x, y, z, yaw), VEL_YAW
// (velocity north, east, down, yaw), VEL_HEIGHT (velocity north, east, z, yaw), ATT_HEIGHT (roll, pitch, z, yaw), ATT
// (roll, pitch, yaw, throttle), PATH (position, velocity, acceleration, yaw) or CTRL (the vehicle's own command).
struct Order {
  std::string vehicle;
  pb::Step::Type kind;
  std::vector<double> numbers;
};

// A message that a vehicle has heard over the radio.
struct Heard {
  std::string sender;
  double sent = 0.0;      // when it was handed to the sender's radio [s]
  double received = 0.0;  // when it was known [s]
  double rssi = 0.0;      // [dBm]
  std::vector<double> payload;
};

// What one vehicle senses: sensor -> field -> numbers, when each reading was true [s], and whether it has arrived at
// this tick.
struct SensedVehicle {
  bool valid = false;
  std::string reason;  // why it is invalid
  std::map<std::string, std::map<std::string, std::vector<double>>> sensors;
  std::map<std::string, double> times;
  std::map<std::string, bool> fresh;
  std::optional<std::array<double, 13>> state;  // true, where it was asked for
  std::vector<Heard> heard;                     // over the radio, the newest message of each sender, the newest first
};

struct Sensed {
  std::uint64_t tick = 0;
  double time = 0.0;         // of the tick [s]
  double sent = 0.0;         // monotonic clock of the server [s]
  std::uint64_t missed = 0;  // readings that this client was too slow for
  std::map<std::string, SensedVehicle> vehicles;
};

class Client {
 public:
  // Connects. timeout_s is how long to wait for a reply [s]; the first step of each kind may have to be compiled.
  explicit Client(const std::string& host = "127.0.0.1", int port = 10000, double timeout_s = 60.0)
      : where_(host + ":" + std::to_string(port)) {
    addrinfo wanted{};
    wanted.ai_family = AF_UNSPEC;
    wanted.ai_socktype = SOCK_STREAM;
    addrinfo* found = nullptr;
    const int failure = getaddrinfo(host.c_str(), std::to_string(port).c_str(), &wanted, &found);
    if (failure != 0) throw ConnectionFailed("cannot connect to " + where_ + ": " + gai_strerror(failure));
    const std::unique_ptr<addrinfo, void (*)(addrinfo*)> addresses(found, freeaddrinfo);
    int reason = ECONNREFUSED;
    for (const addrinfo* one = found; one != nullptr && socket_ < 0; one = one->ai_next) {
      socket_ = ::socket(one->ai_family, one->ai_socktype, one->ai_protocol);
      if (socket_ >= 0 && connect(socket_, one->ai_addr, one->ai_addrlen) == 0) break;
      reason = errno;
      close();
    }
    if (socket_ < 0) throw ConnectionFailed("cannot connect to " + where_ + ": " + std::strerror(reason));
    const int yes = 1;
    setsockopt(socket_, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
#ifdef SO_NOSIGPIPE
    setsockopt(socket_, SOL_SOCKET, SO_NOSIGPIPE, &yes, sizeof yes);
#endif
    set_timeout(timeout_s);
  }
  ~Client() { close(); }
  Client(const Client&) = delete;
  Client& operator=(const Client&) = delete;
  Client(Client&& other) noexcept { *this = std::move(other); }
  Client& operator=(Client&& other) noexcept {
    if (this != &other) {
      close();
      where_ = std::move(other.where_);
      socket_ = std::exchange(other.socket_, -1);
      time_step_ = other.time_step_;
      size_ = other.size_;
      pushed_ = std::move(other.pushed_);
    }
    return *this;
  }

  // Number of vehicles of the session, and its simulation step [s]; a step's dt is a multiple of it.
  int size() const { return size_; }
  double time_step() const { return time_step_; }

  // ---- the calls of the reference client ----

  // Starts a task by its name and returns the state at the start; see also open.
  State init(const std::string& task, bool realtime = false) {
    pb::Message request;
    request.set_type(pb::Message::INIT);
    request.mutable_init()->set_task(task);
    request.mutable_init()->set_realtime(realtime);
    State found = state_of(ask(request, pb::Message::STATE).state());
    note(expected(receive(), pb::Message::TASKINFO).taskinfo());
    return found;
  }

  // Starts the next episode of the task; restart does it too, and returns its seed and its state.
  void reset() {
    pb::Message request;
    request.set_type(pb::Message::RESET);
    request.mutable_reset()->set_value(true);
    ask(request, pb::Message::ACK);
  }

  // Puts the vehicles into states of 3 (position NED), 6 (and Euler angles), 12 (and body velocity and rates) or 13
  // numbers (and thrust).
  void set_state(const Rows& states) {
    pb::Message request;
    request.set_type(pb::Message::SETSTATE);
    auto* content = request.mutable_setsstate();
    for (const auto& row : states) fill(content->add_x(), row);
    ask(request, pb::Message::ACK);
  }

  // Flies to waypoints (x, y, z NED [m], yaw [rad]) for a simulated time dt [s].
  State step_waypoint(double dt, const Rows& waypoints) { return step(dt, pb::Step::WP, waypoints); }

  // Flies commands (pitch, roll [rad], throttle, yaw rate [rad/s], battery [V]) for a simulated time dt [s].
  State step_control(double dt, const Rows& commands) { return step(dt, pb::Step::CTRL, commands); }

  // Flies at velocities NED [m/s], heading north, for a simulated time dt [s].
  State step_velocity(double dt, const Rows& velocities) { return step(dt, pb::Step::VEL, velocities); }

  // Flies set-points of a kind (see Order) for a simulated time dt [s].
  State step_setpoint(double dt, pb::Step::Type kind, const Rows& setpoints) { return step(dt, kind, setpoints); }

  // Ends the session and the connection.
  void disconnect() { leave(false); }

  // Ends the session and asks the server to end; returns what it says where it goes on, else "".
  std::string quit() { return leave(true); }

  // ---- extensions ----

  // Asks what the server is; from then on a step after which a vehicle is invalid returns a state with reasons.
  pb::Server hello() {
    pb::Message request;
    request.set_type(pb::Message::HELLO);
    request.mutable_hello();
    return ask(request, pb::Message::SERVER).server();
  }

  // Starts a session with a seed, a pace, events, or a scenario of your own.
  Session open(const SessionOptions& options) {
    pb::Message request;
    request.set_type(pb::Message::OPEN);
    auto* content = request.mutable_open();
    if (options.task) content->set_task(*options.task);
    if (options.scenario) content->set_scenario(*options.scenario);
    if (options.seed) content->set_seed(*options.seed);
    if (options.realtime) content->set_realtime(*options.realtime);
    content->set_events(options.events);
    return session_of(ask(request, pb::Message::SESSION).session());
  }

  // Starts the next episode of the task, or that of a seed.
  Session restart(std::optional<std::uint64_t> seed = std::nullopt) {
    pb::Message request;
    request.set_type(pb::Message::RESTART);
    auto* content = request.mutable_restart();
    if (seed) content->set_seed(*seed);
    return session_of(ask(request, pb::Message::SESSION).session());
  }

  // Returns what every sensor says.
  Readings readings() {
    pb::Message request;
    request.set_type(pb::Message::GET_READINGS);
    request.mutable_get_readings();
    const pb::Message reply = ask(request, pb::Message::READINGS);
    Readings found;
    for (const auto& vehicle : reply.readings().vehicle())
      for (const auto& sensor : vehicle.sensor())
        for (const auto& field : sensor.field())
          found[vehicle.name()][sensor.name()][field.name()].assign(field.value().begin(), field.value().end());
    return found;
  }

  // Watches the session that another client controls; next_state returns its states as they come.
  void watch(std::optional<std::uint32_t> session = std::nullopt, double period = 0.0) {
    pb::Message request;
    request.set_type(pb::Message::WATCH);
    auto* content = request.mutable_watch();
    if (session) content->set_session(*session);
    content->set_period(period);
    ask(request, pb::Message::ACK);
  }
  State next_state() { return state_of(expected(receive(), pb::Message::STATE).state()); }

  // Asks what the world is made of: area, obstacles, wind, fleets with their sensors and the orders that they take.
  pb::World describe() {
    pb::Message request;
    request.set_type(pb::Message::DESCRIBE);
    request.mutable_describe();
    return ask(request, pb::Message::WORLD).world();
  }

  // ---- a world that several clients share (qrsim serve SCENARIO --pace free or barrier) ----

  // Claims the exclusive command of vehicles, all of them or none; by default all that are free. on_silence is what they
  // do without this client ("hold", "return", "stop"), hold after how many seconds without an order (0: never).
  pb::Claimed claim(const std::vector<std::string>& vehicles = {}, std::optional<std::string> on_silence = std::nullopt,
                    std::optional<double> hold = std::nullopt) {
    pb::Message request;
    request.set_type(pb::Message::CLAIM);
    auto* content = request.mutable_claim();
    for (const auto& name : vehicles) content->add_vehicle(name);
    if (on_silence) content->set_on_silence(*on_silence);
    if (hold) content->set_hold(*hold);
    return ask(request, pb::Message::CLAIMED).claimed();
  }

  // Gives vehicles, by default all, back to the guidance of their scenario.
  void release(const std::vector<std::string>& vehicles = {}) {
    pb::Message request;
    request.set_type(pb::Message::RELEASE);
    auto* content = request.mutable_release();
    for (const auto& name : vehicles) content->add_vehicle(name);
    ask(request, pb::Message::ACK);
  }

  // Gives orders, and returns the tick from which they are flown (pace free).
  std::uint64_t command(const std::vector<Order>& orders, std::optional<std::uint64_t> computed_from = std::nullopt) {
    return ask(command_of(orders, computed_from), pb::Message::COMMANDED).commanded().tick();
  }

  // Gives orders, waits until all who fly here are so many ticks on, and returns what one's vehicles sense there (pace
  // barrier). Vehicles without an order fly on by their last one.
  Sensed advance(const std::vector<Order>& orders, std::uint64_t ticks = 1, bool truth = false) {
    pb::Message request = command_of(orders, std::nullopt);
    request.mutable_command()->set_ticks(ticks);
    request.mutable_command()->set_truth(truth);
    return sensed_of(ask(request, pb::Message::READINGS).readings());
  }

  // Has what vehicles sense pushed, at a rate per simulated second, by default at each tick; no vehicles: those that one
  // has claimed. next_sensed returns it in its order, and waits for it.
  void subscribe(const std::vector<std::string>& vehicles = {}, std::optional<double> rate = std::nullopt,
                 bool truth = false) {
    pb::Message request;
    request.set_type(pb::Message::SUBSCRIBE);
    auto* content = request.mutable_subscribe();
    for (const auto& name : vehicles) content->add_vehicle(name);
    if (rate) content->set_rate(*rate);
    content->set_truth(truth);
    ask(request, pb::Message::ACK);
  }
  Sensed next_sensed() {
    if (pushed_.empty()) return sensed_of(expected(receive(), pb::Message::SENSED).sensed());
    const Sensed found = sensed_of(pushed_.front());
    pushed_.pop_front();
    return found;
  }

  // Hands messages to the radios of vehicles, all or none; to: who alone is to hear them. In a shared world of claimed
  // vehicles only, and of several messages of one in a tick the last one counts.
  void say(const std::map<std::string, std::vector<double>>& words, std::optional<std::string> to = std::nullopt) {
    pb::Message request;
    request.set_type(pb::Message::SAY);
    auto* content = request.mutable_say();
    for (const auto& [vehicle, numbers] : words) {
      auto* added = content->add_words();
      added->set_vehicle(vehicle);
      for (const double number : numbers) added->add_value(number);
      if (to) added->set_to(*to);
    }
    ask(request, pb::Message::ACK);
  }

  // Lets something fail from the next tick on, and returns what the server says of it. target: an injectable sensor,
  // "rotor N", "battery", or "world" for its wind; numbers: how large it is; vehicles: by default all that have it, in a
  // shared world those that one has claimed; at, duration: simulated time [s].
  std::string inject(const std::string& target, const std::string& kind, const std::map<std::string, double>& numbers = {},
                     const std::vector<std::string>& vehicles = {}, std::optional<std::string> field = std::nullopt,
                     std::optional<double> at = std::nullopt, std::optional<double> duration = std::nullopt) {
    pb::Message request;
    request.set_type(pb::Message::INJECT);
    auto* content = request.mutable_inject();
    content->set_target(target);
    content->set_kind(kind);
    for (const auto& name : vehicles) content->add_vehicle(name);
    for (const auto& [name, value] : numbers) {
      auto* added = content->add_number();
      added->set_name(name);
      added->set_value(value);
    }
    if (field) content->set_field(*field);
    if (at) content->set_at(*at);
    if (duration) content->set_duration(*duration);
    return ask(request, pb::Message::ACK).ack().msg();
  }

  // Ends injected faults of a target, by default of all, and returns what the server says.
  std::string clear(std::optional<std::string> target = std::nullopt, const std::vector<std::string>& vehicles = {}) {
    pb::Message request;
    request.set_type(pb::Message::CLEAR);
    auto* content = request.mutable_clear();
    if (target) content->set_target(*target);
    for (const auto& name : vehicles) content->add_vehicle(name);
    return ask(request, pb::Message::ACK).ack().msg();
  }

  // What each vehicle has heard over the radio, the newest message of each sender, the newest first.
  std::map<std::string, std::vector<Heard>> inbox() {
    pb::Message request;
    request.set_type(pb::Message::GET_READINGS);
    request.mutable_get_readings();
    std::map<std::string, std::vector<Heard>> found;
    const pb::Message reply = ask(request, pb::Message::READINGS);
    for (const auto& vehicle : reply.readings().vehicle()) found[vehicle.name()] = heard_of(vehicle);
    return found;
  }

  // Asks who flies what, how old the orders are, and how the pace is kept.
  pb::Status status() {
    pb::Message request;
    request.set_type(pb::Message::GET_STATUS);
    request.mutable_get_status();
    return ask(request, pb::Message::STATUS).status();
  }

  // Sends any request and returns its reply, for what has no call here (GET_EVENTS, PACE, PLAY, ACT). What is pushed
  // meanwhile waits for next_sensed, the oldest going first where it is too much.
  pb::Message ask(const pb::Message& request, pb::Message::Type type) {
    send(request);
    pb::Message reply = receive();
    for (; reply.type() == pb::Message::SENSED; reply = receive()) {
      if (pushed_.size() == kMostPushed) pushed_.pop_front();
      pushed_.push_back(reply.sensed());
    }
    return expected(std::move(reply), type);
  }

  // Closes the connection; the server ends the session.
  void close() noexcept {
    if (socket_ >= 0) ::close(socket_);
    socket_ = -1;
  }

 private:
  static constexpr std::uint32_t kLargestReply = 1u << 26;
  static constexpr std::size_t kMostPushed = 1000;

  static pb::Message command_of(const std::vector<Order>& orders, std::optional<std::uint64_t> computed_from) {
    pb::Message request;
    request.set_type(pb::Message::COMMAND);
    auto* content = request.mutable_command();
    for (const auto& order : orders) {
      auto* added = content->add_order();
      added->set_vehicle(order.vehicle);
      added->set_type(order.kind);
      fill(added->mutable_cmd(), order.numbers);
    }
    if (computed_from) content->set_computed_from(*computed_from);
    return request;
  }

  static std::vector<Heard> heard_of(const pb::Readings::Vehicle& vehicle) {
    std::vector<Heard> found;
    for (const auto& each : vehicle.heard())
      found.push_back({each.sender(), each.sent(), each.received(), each.rssi(),
                       {each.value().begin(), each.value().end()}});
    return found;
  }

  Sensed sensed_of(const pb::Readings& found) {
    Sensed sensed;
    sensed.tick = found.tick();
    sensed.time = found.t();
    sensed.sent = found.sent();
    sensed.missed = found.missed();
    for (const auto& vehicle : found.vehicle()) {
      SensedVehicle& seen = sensed.vehicles[vehicle.name()];
      seen.valid = vehicle.valid();
      seen.reason = vehicle.reason();
      seen.heard = heard_of(vehicle);
      if (vehicle.has_x()) seen.state = numbers<13>(vehicle.x());
      for (const auto& sensor : vehicle.sensor()) {
        seen.times[sensor.name()] = sensor.time();
        seen.fresh[sensor.name()] = sensor.fresh();
        for (const auto& field : sensor.field())
          seen.sensors[sensor.name()][field.name()].assign(field.value().begin(), field.value().end());
      }
    }
    return sensed;
  }

  void set_timeout(double seconds) {
    timeval limit{};
    limit.tv_sec = static_cast<time_t>(std::floor(seconds));
    limit.tv_usec = static_cast<suseconds_t>(1e6 * (seconds - std::floor(seconds)));
    setsockopt(socket_, SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof limit);
    setsockopt(socket_, SOL_SOCKET, SO_SNDTIMEO, &limit, sizeof limit);
  }

  [[noreturn]] void fail(const std::string& why) {
    close();
    throw ConnectionFailed(where_ + ": " + why);
  }

  [[noreturn]] void fail_by_system() {
    const int reason = errno;
    fail(reason == EAGAIN || reason == EWOULDBLOCK ? "no answer in time"
                                                   : std::string("the connection is lost: ") + std::strerror(reason));
  }

  // Length and message go in one write, so that neither waits for an acknowledgement.
  void send(const pb::Message& message) {
    if (socket_ < 0) throw ConnectionFailed(where_ + ": this client is closed");
    const std::string payload = message.SerializeAsString();
    const auto length = static_cast<std::uint32_t>(payload.size());
    std::string content(1, '\x0d');
    for (int shift = 0; shift < 32; shift += 8) content.push_back(static_cast<char>((length >> shift) & 0xFFu));
    content += payload;
#ifdef MSG_NOSIGNAL
    const int flags = MSG_NOSIGNAL;
#else
    const int flags = 0;
#endif
    for (std::size_t done = 0; done < content.size();) {
      const ssize_t count = ::send(socket_, content.data() + done, content.size() - done, flags);
      if (count < 0 && errno == EINTR) continue;
      if (count < 0) {
        // What the server said before it closed the connection says more than this.
        if (errno == EPIPE || errno == ECONNRESET) return;
        fail_by_system();
      }
      done += static_cast<std::size_t>(count);
    }
  }

  std::string exactly(std::size_t size) {
    std::string found(size, '\0');
    for (std::size_t done = 0; done < size;) {
      const ssize_t count = ::recv(socket_, &found[done], size - done, 0);
      if (count < 0 && errno == EINTR) continue;
      if (count < 0) fail_by_system();
      if (count == 0) fail("the server has closed the connection");
      done += static_cast<std::size_t>(count);
    }
    return found;
  }

  pb::Message receive() {
    if (socket_ < 0) throw ConnectionFailed(where_ + ": this client is closed");
    const std::string head = exactly(5);
    std::uint32_t length = 0;
    for (int i = 4; i > 0; --i) length = length << 8 | static_cast<unsigned char>(head[static_cast<std::size_t>(i)]);
    if (head[0] != '\x0d' || length > kLargestReply) fail("this is no qrsim server");
    pb::Message message;
    if (!message.ParseFromString(exactly(length))) fail("this is no qrsim server");
    return message;
  }

  pb::Message expected(pb::Message reply, pb::Message::Type type) {
    if (reply.type() == type && !(type == pb::Message::ACK && reply.ack().error())) return reply;
    if (reply.type() != pb::Message::ACK) fail("an unexpected reply, of type " + std::to_string(reply.type()));
    const std::string& why = reply.ack().msg();
    if (why == "invalid uav state") throw InvalidState(where_ + ": " + why);
    throw Refused(where_ + ": " + why);
  }

  State step(double dt, pb::Step::Type type, const Rows& rows) {
    pb::Message request;
    request.set_type(pb::Message::STEP);
    auto* content = request.mutable_step();
    content->set_dt(dt);
    content->set_type(type);
    for (const auto& row : rows) fill(content->add_cmd(), row);
    return state_of(ask(request, pb::Message::STATE).state());
  }

  std::string leave(bool quit_server) {
    pb::Message request;
    request.set_type(pb::Message::DISCONNECT);
    request.mutable_disconnect()->set_quit(quit_server);
    std::string said = ask(request, pb::Message::ACK).ack().msg();
    close();
    return said;
  }

  void note(const pb::TaskInfo& info) {
    time_step_ = info.timestep();
    size_ = info.numuavs();
  }

  Session session_of(const pb::Session& found) {
    note(found.info());
    return {found.id(), found.scenario(), found.seed(), {found.vehicle().begin(), found.vehicle().end()},
            found.info().timestep(), state_of(found.state())};
  }

  State state_of(const pb::State& found) {
    State state;
    state.time = found.t();
    for (const auto& row : found.x()) state.state.push_back(numbers<13>(row));
    for (const auto& row : found.ex()) state.measured.push_back(numbers<20>(row));
    state.reasons.assign(found.reason().begin(), found.reason().end());
    return state;
  }

  template <std::size_t N>
  std::array<double, N> numbers(const pb::Arrayd& row) {
    if (static_cast<std::size_t>(row.value_size()) != N) fail("a vector of an unexpected length");
    std::array<double, N> found{};
    for (std::size_t i = 0; i < N; ++i) found[i] = row.value(static_cast<int>(i));
    return found;
  }

  static void fill(pb::Arrayd* vector, const std::vector<double>& row) {
    for (const double value : row) vector->add_value(value);
  }

  std::string where_;
  int socket_ = -1;
  double time_step_ = 0.0;
  int size_ = 0;
  std::deque<pb::Readings> pushed_;
};

}  // namespace qrsim
