// The second opinion on OPC UA: node-opcua with the events of a JSON file ([[tag, milliseconds, value], ...]) as history.
//     node opcua_server.js '{"port": 4841, "events": "events.json", "pki": "folder"}'      prints "ready"
// It is found where NODE_PATH says: npm install node-opcua, somewhere outside of the project.
"use strict";
const fs = require("fs");
const {
    DataType, MessageSecurityMode, OPCUACertificateManager, OPCUAServer, SecurityPolicy, StatusCodes, Variant,
} = require("node-opcua");

async function serve(said) {
    const server = new OPCUAServer({
        port: said.port,
        host: "127.0.0.1",
        hostname: "127.0.0.1",
        securityPolicies: [SecurityPolicy.None, SecurityPolicy.Basic256Sha256, SecurityPolicy.Aes256_Sha256_RsaPss],
        securityModes: [MessageSecurityMode.None, MessageSecurityMode.Sign, MessageSecurityMode.SignAndEncrypt],
        serverCertificateManager: new OPCUACertificateManager({
            automaticallyAcceptUnknownCertificate: true, rootFolder: said.pki,
        }),
        userManager: { isValidUser: (name, password) => name === said.user && password === said.password },
    });
    await server.initialize();
    const space = server.engine.addressSpace;
    const own = space.getOwnNamespace();
    const variables = new Map();
    for (const [tag, at, value] of JSON.parse(fs.readFileSync(said.events, "utf8"))) {
        if (!variables.has(tag)) {
            const made = own.addVariable({
                browseName: tag, organizedBy: space.rootFolder.objects, dataType: "Double", nodeId: `s=${tag}`,
            });
            space.installHistoricalDataNode(made, { maxOnlineValues: 100000 });
            variables.set(tag, made);
        }
        const variant = new Variant({ dataType: DataType.Double, value });
        variables.get(tag).setValueFromSource(variant, StatusCodes.Good, new Date(at));
    }
    await server.start();
    console.log("ready");
}

serve(JSON.parse(process.argv[2])).catch((error) => {
    console.error(error);
    process.exit(1);
});
