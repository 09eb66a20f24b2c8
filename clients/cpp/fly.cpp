// Flies the default task of a server for ten seconds: fly [PORT]
#include <cstdio>
#include <cstdlib>

#include "qrsim_client.hpp"

int main(int count, char** words) try {
  qrsim::Client client("127.0.0.1", count > 1 ? std::atoi(words[1]) : 10000);
  qrsim::State state = client.init("free_flight");
  std::printf("%d vehicles, time step %g s\n", client.size(), client.time_step());
  for (int second = 0; second < 10; ++second) {
    // x, y, z (NED, metres) and yaw of each vehicle, for one second.
    state = client.step_waypoint(1.0, qrsim::Rows(static_cast<std::size_t>(client.size()), {8.0, -6.0, -10.0, 0.0}));
    const auto& vehicle = state.state[0];
    std::printf("t = %g s: %.2f %.2f %.2f\n", state.time, vehicle[0], vehicle[1], vehicle[2]);
  }
  client.disconnect();
  return 0;
} catch (const qrsim::Error& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
