// node validate.cjs MODULE FILE: the report of the Khronos glTF validator as JSON.
const fs = require("fs");
const path = require("path");
const validator = require(process.argv[2]);
const file = process.argv[3];
const beside = (uri) => fs.promises.readFile(path.join(path.dirname(file), decodeURIComponent(uri)));
validator
  .validateBytes(new Uint8Array(fs.readFileSync(file)), { uri: path.basename(file), externalResourceFunction: beside })
  .then((report) => console.log(JSON.stringify(report)));
