// A client that behaves as those of the reference simulator do: each length message and each payload is read by one
// recv, into a buffer of 10 000 bytes. What the replies say is printed, a line for each.
#include <arpa/inet.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

#include "qrsim.pb.h"

using qrsimsrvcli::Message;
using qrsimsrvcli::Step;

namespace {

[[noreturn]] void fail(const char* what) {
  std::fprintf(stderr, "failed: %s\n", what);
  std::exit(1);
}

class Connection {
 public:
  explicit Connection(int port) : socket_(::socket(AF_INET, SOCK_STREAM, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<uint16_t>(port));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (connect(socket_, reinterpret_cast<sockaddr*>(&address), sizeof address) != 0) fail("connect");
    int yes = 1;
    setsockopt(socket_, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
  }
  ~Connection() { close(socket_); }

  void send(const Message& message) {
    std::string payload = message.SerializeAsString();
    qrsimsrvcli::Size size;
    size.set_value(static_cast<uint32_t>(payload.size()));
    std::string content = size.SerializeAsString() + payload;
    if (::send(socket_, content.data(), content.size(), 0) != static_cast<ssize_t>(content.size())) fail("send");
  }

  Message receive() {
    pollfd waiting{socket_, POLLIN, 0};
    if (poll(&waiting, 1, 60000) != 1) fail("no reply");
    char buffer[10000];
    if (recv(socket_, buffer, 5, 0) != 5) fail("the length message is not of 5 bytes");
    qrsimsrvcli::Size size;
    if (!size.ParseFromArray(buffer, 5)) fail("the length message is no Size");
    // The payload must be there already: it came with its length in one write.
    ssize_t found = recv(socket_, buffer, size.value(), MSG_DONTWAIT);
    if (found != static_cast<ssize_t>(size.value())) fail("the payload did not come with its length");
    Message message;
    if (!message.ParseFromArray(buffer, static_cast<int>(found))) fail("the payload is no Message");
    return message;
  }

  // Nothing is left to read: every request had one reply.
  void quiet() {
    usleep(20000);
    int waiting = 0;
    if (ioctl(socket_, FIONREAD, &waiting) != 0 || waiting != 0) fail("more came than was asked for");
  }

 private:
  int socket_;
};

void print(const char* what, const Message& reply) {
  if (reply.type() == Message::STATE) {
    const auto& state = reply.state();
    std::printf("%s STATE t %.17g vehicles %d/%d of %d/%d", what, state.t(), state.x_size(), state.ex_size(),
                state.x(0).value_size(), state.ex(0).value_size());
    for (int i = 0; i < 13; ++i) std::printf(" %.17g", state.x(0).value(i));
    std::printf("\n");
  } else if (reply.type() == Message::ACK) {
    std::printf("%s ACK error %d %s\n", what, reply.ack().error(), reply.ack().msg().c_str());
  } else {
    std::printf("%s TASKINFO %.17g %d\n", what, reply.taskinfo().timestep(), reply.taskinfo().numuavs());
  }
}

Message step(Step::Type type, double dt, const std::vector<double>& values) {
  Message message;
  message.set_type(Message::STEP);
  message.mutable_step()->set_dt(dt);
  message.mutable_step()->set_type(type);
  auto* command = message.mutable_step()->add_cmd();
  for (double value : values) command->add_value(value);
  return message;
}

Message disconnect(bool quit) {
  Message message;
  message.set_type(Message::DISCONNECT);
  message.mutable_disconnect()->set_quit(quit);
  return message;
}

void init(Connection& connection, const std::string& task) {
  Message message;
  message.set_type(Message::INIT);
  message.mutable_init()->set_task(task);
  message.mutable_init()->set_realtime(false);
  connection.send(message);
  print("init", connection.receive());
  print("init", connection.receive());
}

}  // namespace

int main(int count, char** words) {
  if (count != 3) fail("usage: reference_client PORT TASK");
  const int port = std::atoi(words[1]);
  {
    Connection connection(port);
    init(connection, words[2]);
    const auto ask = [&](const char* what, const Message& message) {
      connection.send(message);
      print(what, connection.receive());
    };
    ask("wp", step(Step::WP, 0.2, {7.0, -8.0, -9.5, 0.3}));
    ask("ctrl", step(Step::CTRL, 0.02, {0.01, -0.02, 0.6, 0.1, 11.8}));
    ask("vel", step(Step::VEL, 1.0, {0.5, 0.0, -0.2}));
    ask("wrong", step(Step::VEL, 0.03, {0.5, 0.0, -0.2}));
    Message reset;
    reset.set_type(Message::RESET);
    reset.mutable_reset()->set_value(false);
    ask("reset", reset);
    Message put;
    put.set_type(Message::SETSTATE);
    auto* state = put.mutable_setsstate()->add_x();
    for (double value : {5.0, -6.0, -8.0, 0.0, 0.1, 0.2}) state->add_value(value);
    ask("setstate", put);
    ask("wp", step(Step::WP, 0.02, {5.0, -6.0, -8.0, 0.2}));
    connection.quiet();
    ask("disconnect", disconnect(false));
  }
  {
    Connection connection(port);
    init(connection, words[2]);
    connection.send(disconnect(false));
    print("disconnect", connection.receive());
  }
  Connection fresh(port);
  fresh.send(disconnect(true));
  print("quit", fresh.receive());
  return 0;
}
