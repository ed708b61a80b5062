// Runs the firmware under MicroPython: FOLDER of micropython.mjs, then files to put beside each other, the last to run.
// Then a line "NAME ARGUMENT" in calls that function with the text, and a line out is what it returns.
import fs from "node:fs";
import path from "node:path";
import readline from "node:readline";
import { pathToFileURL } from "node:url";

const [folder, ...files] = process.argv.slice(2);
const { loadMicroPython } = await import(pathToFileURL(path.join(folder, "micropython.mjs")));
const micropython = await loadMicroPython({ heapsize: 1 << 20 });
for (const file of files) {
  micropython.FS.writeFile("/" + path.basename(file), fs.readFileSync(file));
}
micropython.runPython("import sys\nsys.path.insert(0, '/')");
const complain = (error) => {
  process.stdout.write(JSON.stringify({ error: error.message }) + "\n");
  process.exit(1);
};
process.on("uncaughtException", complain);
try {
  micropython.runPython(fs.readFileSync(files.at(-1), "utf8"));
} catch (error) {
  complain(error);
}
for await (const line of readline.createInterface({ input: process.stdin })) {
  const space = line.indexOf(" ");
  process.stdout.write(micropython.globals.get(line.slice(0, space))(line.slice(space + 1)) + "\n");
}
