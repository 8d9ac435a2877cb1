// Messages and services in TypeScript, out of the descriptors that the host itself answers reflection with.
import { create, fromBinary, toBinary } from '@bufbuild/protobuf';
import { CodeGeneratorRequestSchema, CodeGeneratorResponseSchema, FileDescriptorSetSchema } from '@bufbuild/protobuf/wkt';
import { spawnSync } from 'node:child_process';
import fs from 'node:fs';
import path from 'node:path';

const [from, to] = process.argv.slice(2);
const set = fromBinary(FileDescriptorSetSchema, fs.readFileSync(from));
const request = create(CodeGeneratorRequestSchema, {
  fileToGenerate: set.file.map((f) => f.name).filter((name) => name.startsWith('trocar/')),
  parameter: 'target=ts',
  protoFile: set.file,
});
const made = spawnSync(process.execPath, ['node_modules/@bufbuild/protoc-gen-es/bin/protoc-gen-es'], { input: toBinary(CodeGeneratorRequestSchema, request), maxBuffer: 64 << 20 });
if (made.status !== 0) throw new Error(String(made.stderr));
const response = fromBinary(CodeGeneratorResponseSchema, made.stdout);
if (response.error) throw new Error(response.error);
fs.rmSync(to, { recursive: true, force: true });
for (const file of response.file) {
  const name = path.join(to, file.name);
  fs.mkdirSync(path.dirname(name), { recursive: true });
  fs.writeFileSync(name, file.content);
}
