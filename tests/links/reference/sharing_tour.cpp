// Flies one vehicle of a shared world for 40 ticks, at a barrier: sharing_tour PORT VEHICLE.
#include <cstdio>
#include <string>

#include "qrsim_client.hpp"

int main(int, char** words) try {
  const std::string name = words[2];
  qrsim::Client client("127.0.0.1", std::stoi(words[1]));
  const auto claimed = client.claim({name}, "return", 2.0);
  std::printf("claimed %s of %s, %s\n", claimed.vehicle(0).c_str(), claimed.scenario().c_str(), claimed.pace().c_str());
  std::fflush(stdout);
  client.subscribe({}, 5.0);
  qrsim::Sensed sensed;
  for (int k = 0; k < 4; ++k)
    sensed = client.advance({{name, qrsim::pb::Step::VEL_HEIGHT, {1.0, 0.5, -11.0, 0.2}}}, 10, true);
  const qrsim::SensedVehicle& vehicle = sensed.vehicles.at(name);
  std::printf("tick %d", static_cast<int>(sensed.tick));
  for (const double value : *vehicle.state) std::printf(" %.17g", value);
  std::printf("\ngnss %d %.17g %.17g\n", vehicle.fresh.at("gnss"), vehicle.times.at("gnss"),
              vehicle.sensors.at("gnss").at("position_ned").at(0));
  for (int k = 0; k < 3; ++k) client.next_sensed();
  std::printf("pushed %d\n", static_cast<int>(client.next_sensed().tick));
  const auto status = client.status();
  std::printf("flies %s %d\n", status.vehicle(0).flies().c_str(), static_cast<int>(status.vehicle(0).misses()));
  client.disconnect();
  return 0;
} catch (const qrsim::Error& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
