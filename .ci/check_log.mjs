// Decode every message of a log with Foxglove's own reader, print their number; any trouble throws.
import { open } from "node:fs/promises";
import { McapIndexedReader } from "@mcap/core";
import { loadDecompressHandlers } from "@mcap/support";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";

const file = await open(process.argv[2], "r");
const readable = {
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, size) => {
    const buffer = new Uint8Array(Number(size));
    const { bytesRead } = await file.read(buffer, 0, buffer.length, Number(offset));
    if (bytesRead !== buffer.length) throw new Error(`${bytesRead} bytes at ${offset} instead of ${size}`);
    return buffer;
  },
};
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers: await loadDecompressHandlers() });
if (reader.header.profile !== "ros2") throw new Error(`profile '${reader.header.profile}'`);
const decoders = new Map();
for (const channel of reader.channelsById.values()) {
  const schema = reader.schemasById.get(channel.schemaId);
  if (channel.messageEncoding !== "cdr" || schema.encoding !== "ros2msg") throw new Error(`${channel.topic}: not ROS 2`);
  const text = new TextDecoder().decode(schema.data);
  decoders.set(channel.id, new MessageReader(parse(text, { ros2: true })));
}
const counts = new Map();
let last = 0n;
for await (const message of reader.readMessages({ validateCrcs: true })) {
  const decoded = decoders.get(message.channelId).readMessage(message.data);
  if (decoded == null || Object.keys(decoded).length === 0) throw new Error("an empty message");
  if (message.logTime < last) throw new Error("messages out of order");
  last = message.logTime;
  counts.set(message.channelId, (counts.get(message.channelId) ?? 0n) + 1n);
}
let total = 0n;
for (const [id, count] of reader.statistics.channelMessageCounts) {
  if (count !== (counts.get(id) ?? 0n)) throw new Error(`channel ${id}: ${counts.get(id)} of ${count} messages`);
  total += count;
}
if (total !== reader.statistics.messageCount) throw new Error("the statistics contradict themselves");
for await (const attachment of reader.readAttachments()) if (attachment.data.length === 0) throw new Error(attachment.name);
for await (const metadata of reader.readMetadata()) if (metadata.metadata.size === 0) throw new Error(metadata.name);
console.log(String(total));
