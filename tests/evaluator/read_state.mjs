// Reads one state topic of a recording from the schema that the file carries: node read_state.mjs FILE TOPIC
import { open } from "node:fs/promises";
import { McapIndexedReader } from "@mcap/core";
import protobuf from "protobufjs";
import "protobufjs/ext/descriptor/index.js";

const [path, topic] = process.argv.slice(2);
const file = await open(path, "r");
const readable = {
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, length) => {
    const buffer = new Uint8Array(Number(length));
    await file.read({ buffer, position: Number(offset) });
    return buffer;
  },
};
const reader = await McapIndexedReader.Initialize({ readable });
const channel = [...reader.channelsById.values()].find((c) => c.topic === topic);
const schema = reader.schemasById.get(channel.schemaId);
const root = protobuf.Root.fromDescriptor(protobuf.ext?.descriptor?.FileDescriptorSet?.decode(schema.data) ?? schema.data);
const StateBlock = root.lookupType(schema.name);

const numbers = [];
let steps = 0;
let shape = [];
for await (const message of reader.readMessages({ topics: [topic] })) {
  const block = StateBlock.decode(message.data);
  numbers.push(...(block.data64.length ? block.data64 : block.data));
  steps += block.steps;
  shape = [block.envs, block.items, block.width];
}
console.log(JSON.stringify({ shape: [steps, ...shape], metadata: Object.fromEntries(channel.metadata), numbers }));
