// Every call of the client in C++: client_tour PORT; prints what came back, a line for each.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <string>
#include <utility>

#include "qrsim_client.hpp"

namespace {

void show(const char* what, const qrsim::State& state) {
  std::printf("%s t %.17g vehicles %zu/%zu reasons %zu", what, state.time, state.state.size(), state.measured.size(),
              state.reasons.size());
  for (double value : state.state.at(0)) std::printf(" %.17g", value);
  std::printf("\n");
}

template <class E>
void thrown(const char* what, const std::function<void()>& call) {
  try {
    call();
    std::printf("%s: nothing was thrown\n", what);
  } catch (const E& error) {
    std::printf("%s: %s\n", what, error.what());
  }
}

}  // namespace

int main(int, char** words) try {
  const int port = std::atoi(words[1]);
  const qrsim::Rows hold = {{6.0, -8.0, -9.0, 0.0}};
  qrsim::Client first("127.0.0.1", port);
  qrsim::Client client = std::move(first);
  show("init", client.init("TaskComplacs"));
  std::printf("info %d %g\n", client.size(), client.time_step());
  show("waypoint", client.step_waypoint(1.0, hold));
  show("velocity", client.step_velocity(0.1, {{0.5, 0.0, 0.0}}));
  show("control", client.step_control(0.02, {{0.0, 0.0, 0.59, 0.0, 12.0}}));
  client.reset();
  client.set_state({{5.0, -6.0, -8.0, 0.0, 0.1, 0.2}});
  show("set_state", client.step_waypoint(0.02, {{5.0, -6.0, -8.0, 0.2}}));
  thrown<qrsim::Refused>("refused", [&] { client.step_waypoint(0.03, hold); });
  thrown<qrsim::InvalidState>("invalid", [&] { client.step_velocity(8.0, {{0.0, 0.0, -3.0}}); });
  std::printf("hello %d\n", client.hello().task_size() > 20);
  qrsim::SessionOptions options;
  options.task = "free_flight";
  options.seed = 5;
  qrsim::Session session = client.open(options);
  std::printf("open %s %llu %s %zu\n", session.scenario.c_str(), static_cast<unsigned long long>(session.seed),
              session.vehicles.at(0).c_str(), session.state.reasons.size());
  std::printf("restart %llu", static_cast<unsigned long long>(client.restart().seed));
  std::printf(" %llu\n", static_cast<unsigned long long>(client.restart(9).seed));
  const qrsim::Readings readings = client.readings();
  std::printf("readings %zu %zu\n", readings.at("pelicans_0").size(),
              readings.at("pelicans_0").at("attitude").at("quaternion").size());
  qrsim::Client watcher("localhost", port);
  watcher.watch();
  client.step_waypoint(0.02, hold);
  std::printf("watched %.17g\n", watcher.next_state().time);
  const qrsim::State stopped = client.step_velocity(8.0, {{0.0, 0.0, -3.0}});
  std::printf("reason %s, measured is NaN: %d\n", stopped.reasons.at(0).c_str(), std::isnan(stopped.measured[0][0]));
  std::printf("world %s %s\n", client.describe().area().type().c_str(), client.describe().fleet(0).vehicle(0).c_str());
  thrown<qrsim::Refused>("owned", [&] { client.claim({"pelicans_0"}); });
  client.disconnect();
  thrown<qrsim::ConnectionFailed>("closed", [&] { client.reset(); });
  thrown<qrsim::Refused>("no task", [&] { qrsim::Client("127.0.0.1", port).init("TaskKeepSpott"); });
  thrown<qrsim::ConnectionFailed>("nobody", [] { qrsim::Client("127.0.0.1", 1); });
  std::printf("quit '%s'\n", qrsim::Client("127.0.0.1", port).quit().c_str());
  return 0;
} catch (const qrsim::Error& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
