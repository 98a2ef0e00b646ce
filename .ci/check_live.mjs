// Watch a flight that is being streamed, as Foxglove does: its client of the protocol, its decoders. Any trouble throws.
// node check_live.mjs ADDRESS; prints the messages decoded by topic as JSON once the server says good-bye.
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import protocol from "@foxglove/ws-protocol";
import WebSocket from "ws";

const [address] = process.argv.slice(2);
const deadline = Date.now() + 120_000; // the first flight compiles the estimators
const counts = {}, topics = new Map();
let clock = 0n;
// Resolves to whether somebody has answered, once the connection is over.
const watch = () => new Promise((resolve) => {
  const socket = new WebSocket(address, ["foxglove.sdk.v1"]), client = new protocol.FoxgloveClient({ ws: socket });
  client.on("status", ({ level, message }) => { if (level > 0) throw new Error(message); });
  client.on("advertise", (channels) => {
    for (const { id, topic, encoding, schema, schemaEncoding } of channels) {
      if (encoding !== "cdr" || schemaEncoding !== "ros2msg") throw new Error(`${topic}: not ROS 2`);
      topics.set(client.subscribe(id), { topic, reader: new MessageReader(parse(schema, { ros2: true })) });
      counts[topic] = 0;
    }
  });
  client.on("message", ({ subscriptionId, data }) => {
    const { topic, reader } = topics.get(subscriptionId), decoded = reader.readMessage(data);
    if (decoded == null || Object.keys(decoded).length === 0) throw new Error(`${topic}: an empty message`);
    counts[topic]++;
  });
  client.on("time", ({ timestamp }) => {
    if (timestamp < clock) throw new Error("the clock goes backwards");
    clock = timestamp;
  });
  client.on("error", () => {});  // nobody there yet: "close" reports it, too
  client.on("close", () => resolve(clock > 0n));
});
while (!(await watch())) {
  if (Date.now() > deadline) throw new Error(`nobody answers at ${address}`);
  await new Promise((resolve) => setTimeout(resolve, 100));
}
console.log(JSON.stringify(counts));
